import { describe, expect, it } from "vitest";
import { TEXTS } from "../../src/generated/interface-texts";
import { ENGLISH, firstWords, wordsOf } from "../../src/page/texts";

describe("words", () => {
  it("have values in the place of names", () => {
    expect(ENGLISH.say("trial", { trial: 2, trials: 8 })).toBe("Trial 2 of 8");
    expect(ENGLISH.say("anchor", { value: "{meaning}", meaning: "$&" })).toBe("{meaning}: $&");
  });

  it("are the browser's until the server tells the participant's", () => {
    expect(firstWords(["de-AT", "en"]).say("stop")).toBe(TEXTS.de.words.stop);
    expect(firstWords(["xx", "de"]).language).toBe("de");
    expect(firstWords([]).language).toBe("en");
    expect(firstWords(["toString"]).language).toBe("en");
    const words = { ...TEXTS.en.words, stop: "قف" };
    expect(wordsOf({ type: "language", language: "ar", direction: "rtl", words }).say("stop")).toBe("قف");
  });
});
