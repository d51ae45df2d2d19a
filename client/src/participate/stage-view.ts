import { createElement } from "../page/dom";
import type { Key, Texts } from "../page/texts";
import area from "./area.svg";
import type { Stage } from "./participant-api";
import seat from "./seat.svg";
import stop from "./stop.svg";

/** What the participant does on the page. */
export interface StageActions {
  act(action: string, body?: object): void;
  /** Shows a code for the headset in this element. */
  showCode(place: HTMLElement): void;
}

/** The elements of a stage. */
export function stageElements(stage: Stage, texts: Texts, actions: StageActions): HTMLElement[] {
  switch (stage.type) {
    case "consent":
      return consent(stage, texts, actions);
    case "inclusion":
      return [createElement("h2", texts.get("host_inclusion")), inclusionForm(stage.questions, texts, actions)];
    case "safety":
      return safety(texts, actions);
    case "ready":
      return ready(stage, texts, actions);
    case "waiting":
      return [
        createElement("p", texts.get(stage.ahead || stage.minutes ? "host_waiting" : "host_starting", { ahead: stage.ahead, minutes: stage.minutes })),
        button(texts.get("host_leave"), () => actions.act("leave"), "quiet"),
      ];
    case "session":
      return [createElement("p", texts.get("host_session")), link(texts.get("host_enter"), `${stage.path}${location.search}#token=${stage.token}`), ...codeForHeadset(texts, actions)];
    case "ended":
      return ended(stage, texts);
  }
}

function consent(stage: Stage & { type: "consent" }, texts: Texts, actions: StageActions): HTMLElement[] {
  const { version, sha256 } = stage;
  const text = createElement("div");
  text.className = "consent";
  text.lang = stage.language;
  text.tabIndex = 0;
  text.setAttribute("role", "region");
  text.setAttribute("aria-label", texts.get("host_consent"));
  text.append(...stage.text.split(/\n\s*\n/).map((paragraph) => createElement("p", paragraph)));
  return [
    createElement("h2", texts.get("host_consent")),
    text,
    small(`${texts.get("host_version", { version })} · SHA-256 ${sha256.slice(0, 16)}…`),
    button(texts.get("host_agree"), () => actions.act("consent", { version, sha256, agreed: true })),
    button(texts.get("host_decline"), () => actions.act("consent", { version, sha256, agreed: false }), "quiet"),
  ];
}

function inclusionForm(questions: [string, string][], texts: Texts, actions: StageActions): HTMLElement {
  const form = createElement("form");
  for (const [id, text] of questions) {
    const field = createElement("fieldset");
    field.append(createElement("legend", text), choice(id, "yes", texts), choice(id, "no", texts));
    form.append(field);
  }
  const send = createElement("button", texts.get("host_send"));
  form.append(send);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const given = new FormData(form);
    actions.act("inclusion", { answers: Object.fromEntries(questions.map(([id]) => [id, given.get(id) === "yes"])) });
  });
  return form;
}

function choice(name: string, value: "yes" | "no", texts: Texts): HTMLElement {
  const label = createElement("label");
  const input = createElement("input");
  Object.assign(input, { type: "radio", name, value, required: true });
  label.append(input, ` ${texts.get(`host_${value}`)}`);
  return label;
}

function safety(texts: Texts, actions: StageActions): HTMLElement[] {
  const guide = createElement("ol");
  guide.className = "guide";
  for (const [picture, key] of [[seat, "host_seat"], [area, "host_area"], [stop, "host_stop"]] as [string, Key][]) {
    const step = createElement("li");
    const image = createElement("img");
    Object.assign(image, { src: picture, alt: "" });
    step.append(image, createElement("p", texts.get(key)));
    guide.append(step);
  }
  return [createElement("h2", texts.get("host_safety")), guide, button(texts.get("host_safe"), () => actions.act("safety"))];
}

function ready(stage: Stage & { type: "ready" }, texts: Texts, actions: StageActions): HTMLElement[] {
  const { minutes, trials } = stage;
  const problem = stage.problem ? [createElement("p", texts.get("host_failed"))] : [];
  const start = stage.is_open
    ? button(texts.get("host_start"), () => actions.act("waiting-list"))
    : createElement("p", texts.get("host_no_start"));
  return [...problem, createElement("p", texts.get("host_ready", { minutes, trials })), start, ...codeForHeadset(texts, actions)];
}

function codeForHeadset(texts: Texts, actions: StageActions): HTMLElement[] {
  const place = createElement("p");
  place.setAttribute("role", "status");
  return [button(texts.get("host_new_code"), () => actions.showCode(place), "quiet"), place];
}

function ended(stage: Stage & { type: "ended" }, texts: Texts): HTMLElement[] {
  const shown: HTMLElement[] = [createElement("p", texts.get(`host_${stage.ending}`))];
  if (stage.code) {
    const code = createElement("p", texts.get("host_your_code", { code: stage.code }));
    code.className = "code";
    shown.push(code);
  }
  if (stage.redirect) shown.push(link(texts.get("host_redirect"), stage.redirect));
  return shown;
}

export function button(text: string, act: () => void, kind = ""): HTMLButtonElement {
  const made = createElement("button", text);
  made.type = "button";
  made.className = kind;
  made.addEventListener("click", act);
  return made;
}

function link(text: string, address: string): HTMLAnchorElement {
  const made = createElement("a", text);
  made.href = address;
  made.className = "button";
  return made;
}

function small(text: string): HTMLElement {
  const made = createElement("p", text);
  made.className = "hint";
  return made;
}
