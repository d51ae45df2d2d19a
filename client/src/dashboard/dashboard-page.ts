import {
  Refusal,
  type Action,
  type Furniture,
  type Identity,
  type Overview,
  type Participant,
  type Results,
  type Study,
} from "./study-api";
import { AdverseEventForm } from "./adverse-event-form";
import { InputFields } from "./input-form";
import {
  adverseEventsTable,
  answeredItems,
  beginText,
  buildTable,
  experimenterText,
  moment,
  paragraphs,
  participantsTable,
  participantText,
  progressText,
  resultsTable,
  resultsText,
  safetyText,
  scoresTable,
  sessionsTable,
  trialsTable,
  type Table,
} from "./tables";
import { showCaregiverLink, showLink } from "./session-link";
import { element } from "../page/dom";

/** The value of a form field. */
function field(form: HTMLFormElement, name: string): string {
  return String(new FormData(form).get(name) ?? "").trim();
}

function identityIn(form: HTMLFormElement): Identity {
  const confirmed = field(form, "confirm_duplicate") !== "";
  return { name: field(form, "name"), contact: field(form, "contact"), confirm_duplicate: confirmed };
}

/** Shows the reason for a refusal and the field that confirms the action, if any; throws the error again. */
function offerConfirmation(form: HTMLFormElement, error: unknown): never {
  if (error instanceof Refusal && error.confirm) {
    showConfirmation(form, error.confirm);
    form.querySelector("p[data-confirm]:not([hidden])")?.replaceChildren(error.message);
    form.querySelector<HTMLInputElement>("[data-confirm]:not([hidden]) input")?.focus();
  }
  throw error;
}

/** Preferences that the form contains in hundredths, by field. */
const HUNDREDTHS: Readonly<Record<string, string>> = { distance_cm: "distance_m", force_percent: "force_share" };

/** The preferences that the form changes, as `name=value`. */
function changesIn(form: HTMLFormElement): string[] {
  const values = [...new FormData(form).entries()].filter(([, value]) => value !== "");
  return values.map(([name, value]) => (name in HUNDREDTHS ? `${HUNDREDTHS[name]}=${Number(value) / 100}` : `${name}=${value}`));
}

/** Shows one confirmation field of a form and hides all others. */
function showConfirmation(form: HTMLFormElement, name: string | null): void {
  for (const field of form.querySelectorAll<HTMLElement>("[data-confirm]")) field.hidden = field.dataset["confirm"] !== name;
}

/** The experimenter's dashboard: tables of the stored data, and forms that change it. */
export class Dashboard {
  private overview: Overview | null = null;
  private chosen: string | null = null;
  private person: Participant | null = null;
  private readonly shown = new Map<string, string>();
  private work = Promise.resolve();
  private readonly adverseEvent = new AdverseEventForm(element("adverse-event"));
  private readonly input = new InputFields(element("input"));
  private readonly firstInput = new InputFields(element("enrol"));

  constructor(private readonly study: Study) {
    this.onSubmit("enrol", (form) => this.enrol(form));
    this.onAct("consent", "consent", "is recorded", (form) => ({ version: this.overview!.consent_version, role: field(form, "role") }));
    this.onAct("decline", "declined-consent", "is stored", () => ({
      version: this.overview!.consent_version,
      role: this.person?.missing_consent === "assent" ? "assent" : "participant",
    }));
    this.onAct("preferences", "preferences", "are stored", (form) => ({ changes: changesIn(form) }));
    this.onAct("respondent", "respondent", "is stored", (form) => ({ respondent: field(form, "respondent") }));
    this.onAct("inclusion", "inclusion", "are recorded", (form) => ({ answers: this.inclusionAnswers(form) }));
    this.onAct("begin", "sessions", "has begun", (form) => ({
      furniture: this.furnitureIn(form),
      own: (form.elements.namedItem("own") as HTMLInputElement).checked,
    }));
    this.onSubmit("link", () => this.renewLink());
    this.onAct("note", "notes", "is stored", (form) => ({ text: field(form, "text") }));
    this.onAct("edit-note", "edited-notes", "is changed", (form) => ({
      id: Number(field(form, "id")),
      text: field(form, "text"),
    }));
    element("edit-note").addEventListener("reset", () => (element("edit-note").hidden = true));
    this.onAct("input", "input", "is changed", () => ({ profile: this.input.profile() }));
    this.onAct("adverse-event", "adverse-events", "is stored", () => this.adverseEvent.body());
    this.onAct("identity", "identity", "are in the identity file", identityIn);
    element("results-part").addEventListener("toggle", () => this.afterwards(() => this.refresh()));
    this.onAct("withdrawal", "withdrawal", "is stored", (form) => ({ reason: field(form, "reason") }));
  }

  /** Loads and shows the present data. */
  async refresh(): Promise<void> {
    try {
      this.overview = await this.study.overview();
      this.showOverview(this.overview);
      if (this.chosen) this.showParticipant(await this.study.participant(this.chosen));
      if (element<HTMLDetailsElement>("results-part").open) this.showResults(await this.study.results());
    } catch (error) {
      this.refuse(`The study cannot be read: ${words(error)}`);
    }
  }

  /** Shows an error. */
  refuse(text: string): void {
    this.announce("refused", text);
  }

  private announce(id: "done" | "refused", text: string): void {
    for (const other of ["done", "refused"]) element(other).hidden = other !== id;
    element(id).textContent = text;
  }

  // Forms

  private onSubmit(id: string, submit: (form: HTMLFormElement) => Promise<void>): void {
    const form = element<HTMLFormElement>(id);
    form.addEventListener("reset", () => showConfirmation(form, null));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.afterwards(() => submit(form).catch((error) => offerConfirmation(form, error)));
    });
  }

  /** Runs actions one after another. */
  private afterwards(work: () => Promise<void>): void {
    this.work = this.work.then(work).catch((error) => this.refuse(`Not done: ${words(error)}`));
  }

  /** Registers a form with an action on the chosen participant. */
  private onAct(id: string, action: Action, outcome: string, body: (form: HTMLFormElement) => object): void {
    this.onSubmit(id, async (form) => {
      const pseudonym = this.chosen!;
      await this.study.act(pseudonym, action, body(form));
      form.reset();
      await this.refresh();
      this.announce("done", `${pseudonym}: ${NOUNS[action]} ${outcome}.`);
      if (form.hidden && hasFocusOrNoneHas(form)) element("participant-heading").focus();
    });
  }

  private async enrol(form: HTMLFormElement): Promise<void> {
    const age = field(form, "age");
    const pseudonym = await this.study.enrol({
      sex: field(form, "sex"),
      age_years: age ? Number(age) : null,
      language: field(form, "language"),
      input: this.firstInput.profile(),
      ...identityIn(form),
    });
    form.reset();
    await this.choose(pseudonym);
    this.announce("done", `${pseudonym} is enrolled.`);
  }

  private async renewLink(): Promise<void> {
    const pseudonym = this.overview!.live!;
    await this.study.act(pseudonym, "links", {});
    await this.refresh();
    this.announce("done", `${pseudonym}: ${NOUNS.links} is made.`);
  }

  private inclusionAnswers(form: HTMLFormElement): Record<string, boolean> {
    const questions = Object.keys(this.person!.inclusion);
    return Object.fromEntries(questions.map((id) => [id, field(form, id) === "yes"]));
  }

  private furnitureIn(form: HTMLFormElement): Furniture {
    const names = Object.keys(this.overview!.furniture) as (keyof Furniture)[];
    return Object.fromEntries(names.map((name) => [name, Number(field(form, name))])) as unknown as Furniture;
  }

  // Display

  private async choose(pseudonym: string): Promise<void> {
    this.chosen = pseudonym;
    for (const form of element("participant").querySelectorAll("form")) form.reset();
    await this.refresh();
    element("participant-heading").focus();
  }

  private showOverview(overview: Overview): void {
    const { summary, live, furniture, languages, warnings, link } = overview;
    showLink(link);
    showCaregiverLink(overview.caregiver_addresses);
    document.title = `${summary.title} – AVR Gym`;
    element("title").textContent = summary.title;
    element("progress").textContent = progressText(overview);
    element("experimenter").textContent = experimenterText(overview);
    element("consent-version").textContent = overview.consent_version;
    element("warnings").hidden = warnings.length === 0;
    this.fill("warnings", warnings, () => warnings.map(line));
    element("language-choice").hidden = Object.keys(languages).length < 2;
    this.fill("language", languages, () => Object.entries(languages).map(([tag, name]) => new Option(name, tag)));
    this.showTable("participants", participantsTable(summary.participants, live), (name) => this.chooser(name));
    this.showFurniture(this.person?.furniture ?? furniture);
    this.adverseEvent.offerScales(overview.scales);
    for (const fields of [this.input, this.firstInput]) fields.offer(overview.input_stops);
    element("scales-words").textContent = overview.scales_words;
  }

  private showResults({ blinded, items, results }: Results): void {
    const ids = Object.keys(items);
    element("results-words").textContent = resultsText(blinded);
    this.showTable("results", resultsTable(results, ids));
    const answered = answeredItems(results, ids);
    this.fill("items", answered, () => answered.map((id) => line(`${id}: ${items[id]}`)));
  }

  /** Sets the default values of the fields, which remain after a reset of the form. */
  private showFurniture(furniture: Furniture): void {
    const fields = element<HTMLFormElement>("begin").elements;
    for (const [name, value] of Object.entries(furniture)) {
      const input = fields.namedItem(name) as HTMLInputElement;
      if (input.defaultValue !== String(value)) input.value = input.defaultValue = String(value);
    }
  }

  private chooser(pseudonym: string): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = button.id = pseudonym;
    button.setAttribute("aria-pressed", String(pseudonym === this.chosen));
    button.addEventListener("click", () => this.afterwards(() => this.choose(pseudonym)));
    return button;
  }

  private showParticipant(person: Participant): void {
    const { participant, state, trials, notes, scores, language, direction, must_reconsent } = person;
    this.person = person;
    const inSession = this.overview?.live === participant;
    element("participant").hidden = false;
    element("participant-heading").textContent = participant;
    element("participant-words").textContent = participantText(person, inSession);
    element("consent-text").textContent = paragraphs(person.consent);
    for (const id of ["consent-text", "questions"]) Object.assign(element(id), { lang: language, dir: direction });
    this.fill("questions", person.inclusion, () => Object.entries(person.inclusion).map(yesOrNo));
    element("begin-button").textContent = beginText(person);
    element("consent").hidden = state !== "enrolled" && !must_reconsent;
    element("decline").hidden = !must_reconsent && person.missing_consent !== "assent";
    this.fill("consents", person.consents, () => person.consents.map(line));
    this.showRespondent(person);
    this.showFurniture(person.furniture ?? this.overview!.furniture);
    (element<HTMLFormElement>("begin").elements.namedItem("own") as HTMLInputElement).disabled = person.furniture !== null;
    element("preferences-part").hidden = person.preferences === null;
    element("preferences-words").textContent = person.preferences_words;
    element("sessions-part").hidden = person.sessions.length === 0;
    this.showTable("sessions", sessionsTable(person.sessions));
    element("inclusion").hidden = state !== "consented" || must_reconsent;
    element("begin").hidden = state !== "allocated" || inSession || must_reconsent;
    element("trials-part").hidden = trials.length === 0;
    element("withdrawal-part").hidden = !person.may_become.includes("withdrawn");
    this.showTable("trials", trialsTable(trials));
    element("scores-part").hidden = scores.length === 0;
    this.showTable("scores", scoresTable(scores));
    this.showAdverseEvents(person);
    this.input.show(person.input, participant);
    element("input-words").textContent = person.input_words;
    this.fill("notes", notes, () => notes.map((note) => this.noteLine(note)));
  }

  /** Shows who answers, unless the experimenter is changing it. */
  private showRespondent({ participant, respondent }: Participant): void {
    const key = `${participant} ${respondent}`;
    if (this.shown.get("respondent") === key) return;
    this.shown.set("respondent", key);
    (element<HTMLFormElement>("respondent").elements.namedItem("respondent") as HTMLSelectElement).value = respondent;
  }

  /** Hides parts that do not apply to simulated participants. */
  private showAdverseEvents({ simulated, adverse_events, safety_events, trials }: Participant): void {
    element("adverse-events-part").hidden = simulated;
    this.showTable("adverse-events", adverseEventsTable(adverse_events));
    element("safety-words").textContent = safety_events.length
      ? "The session reported these events automatically. They are adverse events only if a person was affected:"
      : "";
    this.fill("safety-events", safety_events, () => safety_events.map((each) => line(safetyText(each))));
    this.adverseEvent.offerEvents(adverse_events, trials);
  }

  private noteLine({ id, at, text }: Participant["notes"][number]): HTMLLIElement {
    const item = line(`${moment(at)}: ${text} `);
    const edit = document.createElement("button");
    Object.assign(edit, { type: "button", className: "small", textContent: "Edit", id: `note-${id}` });
    edit.setAttribute("aria-label", `Edit the note of ${moment(at)}`);
    edit.addEventListener("click", () => editNote(id, text));
    item.append(edit);
    return item;
  }

  private showTable(id: string, table: Table, firstCell?: (text: string) => Node): void {
    this.fill(id, [table, firstCell && this.chosen], () => [buildTable(table, firstCell)]);
  }

  /** Rebuilds a part of the page only if its content has changed, and keeps the focus. */
  private fill(id: string, content: unknown, build: () => Node[]): void {
    const text = JSON.stringify(content);
    if (this.shown.get(id) === text) return;
    this.shown.set(id, text);
    const focused = element(id).contains(document.activeElement) ? document.activeElement?.id : "";
    element(id).replaceChildren(...build());
    if (focused) element(focused).focus();
  }
}

/** The object of an action, for its confirmation message. */
const NOUNS: Record<Action, string> = {
  consent: "consent",
  respondent: "who answers",
  preferences: "the preferences",
  "declined-consent": "the withdrawal",
  inclusion: "the answers",
  sessions: "the session",
  links: "the new link",
  notes: "the note",
  "edited-notes": "the note",
  "adverse-events": "the report",
  identity: "name and contact",
  input: "the input",
  withdrawal: "the withdrawal",
};

/** Whether the focus may be moved: the focused form is hidden, or nothing has the focus. */
function hasFocusOrNoneHas(form: HTMLFormElement): boolean {
  const focused = document.activeElement;
  return focused === null || focused === document.body || form.contains(focused);
}

/** Opens the form for editing a note. */
function editNote(id: number, text: string): void {
  const form = element<HTMLFormElement>("edit-note");
  form.hidden = false;
  (form.elements.namedItem("id") as HTMLInputElement).value = String(id);
  const area = form.elements.namedItem("text") as HTMLTextAreaElement;
  area.value = text;
  area.focus();
}

function line(text: string): HTMLLIElement {
  const item = document.createElement("li");
  item.textContent = text;
  return item;
}

function yesOrNo([id, text]: [string, string]): HTMLFieldSetElement {
  const question = document.createElement("fieldset");
  const legend = document.createElement("legend");
  legend.textContent = text;
  question.append(legend, ...["yes", "no"].map((answer) => option(id, answer)));
  return question;
}

function option(name: string, value: string): HTMLLabelElement {
  const label = document.createElement("label");
  const input = document.createElement("input");
  Object.assign(input, { type: "radio", name, value, required: true });
  label.append(input, ` ${value}`);
  return label;
}

function words(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
