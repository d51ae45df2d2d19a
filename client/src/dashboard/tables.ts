import type {
  SessionSummary,
  AdverseEvent,
  ConditionResults,
  Overview,
  Participant,
  ParticipantSummary,
  SafetyEvent,
  Score,
  Trial,
} from "./study-api";

/** A table of plain texts. */
export interface Table {
  caption: string;
  head: string[];
  rows: string[][];
}

/** Builds a table element from text. The first cell of each row is its heading. */
export function buildTable({ caption, head, rows }: Table, firstCell = textNode): HTMLTableElement {
  const table = document.createElement("table");
  table.createCaption().textContent = caption;
  const headRow = table.createTHead().insertRow();
  headRow.append(...head.map((text) => heading(text, "col")));
  const body = table.createTBody();
  for (const [first, ...rest] of rows) {
    const row = body.insertRow();
    const rowHead = heading("", "row");
    rowHead.append(firstCell(first!));
    row.append(rowHead);
    for (const text of rest) row.insertCell().textContent = text;
  }
  return table;
}

function textNode(text: string): Node {
  return document.createTextNode(text);
}

function heading(text: string, scope: "col" | "row"): HTMLTableCellElement {
  const cell = document.createElement("th");
  cell.scope = scope;
  const parts = text.split(/(?<=_)/).flatMap((part) => [document.createElement("wbr"), part]);
  cell.append(...parts.slice(1));
  return cell;
}

export function participantsTable(participants: ParticipantSummary[], live: string | null): Table {
  return {
    caption: participants.length ? "" : "Nobody is enrolled yet.",
    head: ["Participant", "State", "Trials completed", "Sessions"],
    rows: participants.map((each) => [
      each.participant,
      each.state + (each.simulated ? ", simulated" : "") + (each.participant === live ? ", in session" : ""),
      each.trials ? `${each.trials_completed} of ${each.trials}` : "–",
      String(each.sessions),
    ]),
  };
}

export function trialsTable(trials: Trial[]): Table {
  return {
    caption: "",
    head: ["Trial", "Task", "Robot", "Policy", "State", "Attempts", "Reward"],
    rows: trials.map((trial) => [
      trial.practice ? `${trial.position}, practice` : String(trial.position),
      taskWords(trial.task),
      trial.robot,
      trial.policy,
      trial.state + (trial.questionnaire_open ? ", questionnaire open" : ""),
      trial.attempts.join(", ") || "–",
      trial.reward === null ? "–" : trial.reward.toFixed(1) + (trial.success ? ", success" : ", no success"),
    ]),
  };
}

export function adverseEventsTable(events: AdverseEvent[]): Table {
  return {
    caption: events.length ? "" : "No adverse events were recorded.",
    head: ["Event", "Began", "Trial", "What happened", "Severity", "Seriousness", "Related", "Outcome", "Reports"],
    rows: events.map(({ number, reports, report }) => [
      String(number),
      moment(report.began_at),
      report.trial === null ? "–" : String(report.trial),
      report.description,
      report.severity,
      report.seriousness,
      report.relatedness,
      report.outcome,
      String(reports),
    ]),
  };
}

/** A safety event of a session as one line. */
export function safetyText({ at, trial, name, detail }: SafetyEvent): string {
  const where = trial === null ? "" : `, trial ${trial}`;
  return `${moment(at)}${where}: ${name}${detail ? `, ${detail}` : ""}`;
}

/** A stored time in the format of a local time field. */
export function localTime(at: string): string {
  const time = new Date(at);
  return new Date(time.getTime() - 60_000 * time.getTimezoneOffset()).toISOString().slice(0, 16);
}

export function scoresTable(scores: Score[]): Table {
  return {
    caption: "",
    head: ["Asked", "Scale", "Score", "Range"],
    rows: scores.map((each) => [
      each.position === null ? each.moment.replace("_", " the ") : `after trial ${each.position}`,
      `${each.instrument}: ${each.scale}`,
      each.score === null ? "answers missing" : String(Math.round(100 * each.score) / 100),
      `${each.minimum} to ${each.maximum}`,
    ]),
  };
}

/** One row for each session of a participant. */
export function sessionsTable(sessions: SessionSummary[]): Table {
  return {
    caption: "",
    head: ["Session", "Began", "State", "Trials completed", "Minutes in VR", "Breaks"],
    rows: sessions.map(({ number, opened_at, state, trials, minutes, breaks }) => [
      String(number),
      moment(opened_at),
      state,
      String(trials),
      minutes.toFixed(1),
      String(breaks),
    ]),
  };
}

/** The items that were answered after trials. */
export function answeredItems(results: ConditionResults[], items: string[]): string[] {
  return items.filter((item) => results.some(({ answer_means }) => item in answer_means));
}

/** One row for each condition, with a column for each item. */
export function resultsTable(results: ConditionResults[], items: string[]): Table {
  const asked = answeredItems(results, items);
  return {
    caption: results.length ? "" : "No trial is completed yet.",
    head: ["Task", "Robot", "Policy", "Who", "Trials", "Success", "Mean reward", ...asked.map((item) => `Mean ${item}`)],
    rows: results.map((row) => [
      taskWords(row.task),
      row.robot,
      row.policy,
      row.simulated ? "simulated" : "people",
      String(row.trials),
      `${Math.round(100 * row.success_rate)} %`,
      row.reward_mean.toFixed(1),
      ...asked.map((item) => row.answer_means[item]?.toFixed(1) ?? "–"),
    ]),
  };
}

export function progressText({ summary }: Overview): string {
  const { planned, completed, withdrawn, excluded, deleted } = summary;
  return (
    `${completed} of ${planned} participants completed, ${withdrawn} withdrew, ` +
    `${excluded} excluded, ${deleted} deleted.`
  );
}

/** The experimenter of this page, as in the study's log. */
export function experimenterText({ experimenter }: Overview): string {
  return experimenter
    ? `The log names you ${experimenter}.`
    : "The log cannot name you: several people may use this address.";
}

export function resultsText(blinded: boolean): string {
  const policies = blinded ? " Letters replace the names of policies, because this study is blind." : "";
  return `Completed trials without practice, of all participants who did not withdraw.${policies}`;
}

/** The participant and the next step. */
export function participantText(person: Participant, inSession: boolean): string {
  const facts = [
    person.state,
    person.simulated ? "simulated" : "",
    person.sex,
    person.age_years === null ? "" : `${person.age_years} years`,
    `reads ${person.language}`,
    person.identified ? "name stored" : person.simulated ? "" : "no name stored",
    person.consented_at ? `consent version ${person.consent_version}, ${moment(person.consented_at)}` : "no consent yet",
  ];
  return `${facts.filter(Boolean).join("; ")}. ${inSession ? "Their session runs." : nextWords(person)}`;
}

function nextWords({ state, trials, must_reconsent, missing_consent }: Participant): string {
  if (missing_consent === "assent") return "Next: record the assent of the participant.";
  if (missing_consent === "proxy") return "Next: record the consent of the representative.";
  if (must_reconsent) return "Next: ask for consent to the new version of the text.";
  if (state === "enrolled") return "Next: record their consent.";
  if (state === "consented") return "Next: ask the inclusion questions.";
  if (state === "allocated") return trials.some((t) => t.state === "completed") ? "Next: go on." : "Next: begin.";
  return "";
}

/** The label of the button that starts a session. */
export function beginText({ trials }: Participant): string {
  return trials.some(({ state }) => state === "completed") ? "Continue with the remaining trials" : "Begin session";
}

/** A stored time in the local format. */
export function moment(at: string): string {
  return new Date(at).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

/** A hard-wrapped text with one line for each paragraph. */
export function paragraphs(text: string): string {
  return text.trim().replace(/(?<!\n)\n(?!\n)/g, " ");
}

function taskWords(task: string): string {
  return task.replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase();
}
