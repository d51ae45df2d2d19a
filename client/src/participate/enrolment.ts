import { createElement } from "../page/dom";
import type { Texts } from "../page/texts";
import type { Invitation } from "./participant-api";

/** The form with which an invited person takes part. */
export function enrolmentForm(invitation: Invitation, texts: Texts, take: (values: object) => void): HTMLElement {
  const form = createElement("form");
  const language = choices("language", invitation.languages.map((each) => [each.language, each.name]));
  language.value = invitation.languages.find((each) => navigator.language.startsWith(each.language))?.language ?? language.value;
  const body = choices("sex", [["woman", texts.get("woman")], ["man", texts.get("man")]]);
  const age = createElement("input");
  Object.assign(age, { type: "number", name: "age", min: "0", max: "130" });
  if (invitation.languages.length > 1) form.append(labelled(texts.get("host_language"), language));
  form.append(labelled(texts.get("host_body"), body), labelled(texts.get("host_age"), age), createElement("button", texts.get("host_take_part")));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    take({ sex: body.value, language: language.value, age_years: age.value ? Number(age.value) : null });
  });
  return form;
}

/** The form for the code of a participant's page, on a headset. */
export function codeForm(texts: Texts, open: (code: string) => void): HTMLElement {
  const form = createElement("form");
  const code = createElement("input");
  Object.assign(code, { inputMode: "numeric", autocomplete: "off", maxLength: 12, required: true });
  form.append(labelled(texts.get("host_code"), code), createElement("button", texts.get("host_open")));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    open(code.value);
  });
  return form;
}

function labelled(text: string, control: HTMLElement): HTMLElement {
  const label = createElement("label");
  label.append(createElement("span", text), control);
  return label;
}

function choices(name: string, options: [value: string, text: string][]): HTMLSelectElement {
  const select = createElement("select");
  select.name = name;
  for (const [value, text] of options) {
    const option = createElement("option", text);
    option.value = value;
    select.append(option);
  }
  return select;
}
