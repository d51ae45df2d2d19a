import { describe, expect, it } from "vitest";
import { TEXTS } from "../../src/generated/interface-texts";
import { ENGLISH_TEXTS, initialTexts, textsOf } from "../../src/page/texts";

describe("words", () => {
  it("have values in the place of names", () => {
    expect(ENGLISH_TEXTS.get("trial", { trial: 2, trials: 8 })).toBe("Trial 2 of 8");
    expect(ENGLISH_TEXTS.get("anchor", { value: "{meaning}", meaning: "$&" })).toBe("{meaning}: $&");
  });

  it("are the browser's until the server tells the participant's", () => {
    expect(initialTexts(["de-AT", "en"]).get("stop")).toBe(TEXTS.de.texts.stop);
    expect(initialTexts(["xx", "de"]).language).toBe("de");
    expect(initialTexts([]).language).toBe("en");
    expect(initialTexts(["toString"]).language).toBe("en");
    const texts = { ...TEXTS.en.texts, stop: "قف" };
    expect(textsOf({ type: "language", language: "ar", direction: "rtl", texts }).get("stop")).toBe("قف");
  });
});
