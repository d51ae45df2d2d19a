import type { InputProfileMessage } from "../generated/messages";

/** The overview row of a participant. */
export interface ParticipantSummary {
  participant: string;
  state: string;
  simulated: boolean;
  cell: number | null;
  sessions: number;
  trials_completed: number;
  trials: number;
}

export interface ConditionResults {
  task: string;
  robot: string;
  policy: string;
  simulated: boolean;
  trials: number;
  success_rate: number;
  reward_mean: number;
  answer_means: Record<string, number>;
}

/** The real furniture: heights above the floor in metres, angles from the horizontal in degrees. */
export interface Furniture {
  seat_height_m: number;
  seat_depth_m: number;
  seat_back_deg: number;
  seat_tilt_deg: number;
  headrest_m: number;
  mattress_height_m: number;
  mattress_back_deg: number;
}

export interface Overview {
  summary: {
    title: string;
    planned: number;
    completed: number;
    withdrawn: number;
    excluded: number;
    deleted: number;
    participants: ParticipantSummary[];
  };
  consent_version: string;
  /** Names by tag. */
  languages: Record<string, string>;
  /** Low disk space, as text. */
  warnings: string[];
  live: string | null;
  /** The link of the running session. */
  link: { addresses: string[]; code: string } | null;
  furniture: Furniture;
  /** The experimenter of this page's token; empty for a shared token. */
  experimenter: string;
  /** Allowed grades of adverse events, and the sources of the scales. */
  scales: Record<string, string[]>;
  scales_words: string;
  /** The ways to stop of each input method. */
  input_stops: Record<string, string[]>;
  /** Addresses of the caregiver's page. */
  caregiver_addresses: string[];
}

/** The results so far. The study's log records each access. */
export interface Results {
  blinded: boolean;
  items: Record<string, string>;
  results: ConditionResults[];
}

export interface Trial {
  position: number;
  task: string;
  robot: string;
  policy: string;
  practice: boolean;
  state: string;
  attempts: string[];
  success: boolean | null;
  reward: number | null;
  questionnaire_open: boolean;
}

export interface Score {
  moment: string;
  position: number | null;
  instrument: string;
  scale: string;
  score: number | null;
  minimum: number;
  maximum: number;
}

/** A report of an adverse event; `trial` is the position of a trial. */
export interface Report {
  began_at: string;
  trial: number | null;
  description: string;
  severity: string;
  seriousness: string;
  relatedness: string;
  action: string;
  outcome: string;
}

/** The present report of an adverse event, and the number of its reports. */
export interface AdverseEvent {
  number: number;
  reports: number;
  recorded_at: string;
  report: Report;
}

/** A safety event that a session reported. */
export interface SafetyEvent {
  at: string;
  trial: number | null;
  name: string;
  detail: string;
}

/** An input profile; see `recording/input_profile.py`. */
export type InputProfile = Omit<InputProfileMessage, "type">;

/** A session. `minutes`: time in VR. */
export interface SessionSummary {
  number: number;
  opened_at: string;
  state: string;
  trials: number;
  minutes: number;
  breaks: number;
}

export interface Participant {
  participant: string;
  state: string;
  may_become: string[];
  simulated: boolean;
  sex: string;
  age_years: number | null;
  /** How the participant selects and stops, and the same in one line. */
  input: InputProfile;
  input_words: string;
  identified: boolean;
  language: string;
  direction: string;
  /** In the participant's language, like the inclusion questions. */
  consent: string;
  inclusion: Record<string, string>;
  consented_at: string | null;
  consent_version: string | null;
  /** The participant agreed to another version of the consent text than the study's. */
  must_reconsent: boolean;
  /** All decisions about consent texts, as text. */
  consents: string[];
  /** `proxy` or `assent` if only the other one was given. */
  missing_consent: string;
  respondent: string;
  /** Their own seat and bed, if measured. */
  furniture: Furniture | null;
  /** Null if no condition uses preferences. Values that equal the defaults are left out. */
  preferences: Record<string, unknown> | null;
  preferences_words: string;
  sessions: SessionSummary[];
  scores: Score[];
  trials: Trial[];
  notes: { id: number; at: string; text: string }[];
  adverse_events: AdverseEvent[];
  safety_events: SafetyEvent[];
}

/** Actions on a participant; see `study/dashboard/application.py`. */
export type Action = "identity" | "consent" | "declined-consent" | "inclusion" | "input" | "respondent" | "preferences" | "withdrawal" | "notes" | "edited-notes" | "adverse-events" | "sessions" | "links";

/** A participant's identity, and whether the experimenter confirms that no other participant is the same person. */
export interface Identity {
  name: string;
  contact: string;
  confirm_duplicate: boolean;
}

/** An error of the server; `confirm`: the name of the confirmation that permits the action. */
export class Refusal extends Error {
  readonly confirm: string | null;

  constructor(status: number, text: string) {
    const { detail, confirm } = parsed(text);
    super(typeof detail === "string" ? detail : `the server answered with status ${status}`);
    this.confirm = typeof confirm === "string" ? confirm : null;
  }
}

/** Client of the study's API. Every call throws a `Refusal` if the server refuses it. */
export class Study {
  constructor(private readonly token: string) {}

  overview(): Promise<Overview> {
    return this.call("overview") as Promise<Overview>;
  }

  results(): Promise<Results> {
    return this.call("results") as Promise<Results>;
  }

  participant(pseudonym: string): Promise<Participant> {
    return this.call(`participants/${encodeURIComponent(pseudonym)}`) as Promise<Participant>;
  }

  async enrol(somebody: Identity & { sex: string; age_years: number | null; language: string; input: object }): Promise<string> {
    const { participant } = (await this.call("participants", somebody)) as { participant: string };
    return participant;
  }

  async act(pseudonym: string, action: Action, body: object): Promise<void> {
    await this.call(`participants/${encodeURIComponent(pseudonym)}/${action}`, body);
  }

  private async call(path: string, body?: object): Promise<unknown> {
    const headers: Record<string, string> = { Authorization: `Bearer ${this.token}` };
    if (body) headers["Content-Type"] = "application/json";
    const posted = body ? { method: "POST", body: JSON.stringify(body) } : {};
    const response = await fetch(`study/${path}`, { ...posted, headers });
    const text = await response.text();
    if (!response.ok) throw new Refusal(response.status, text);
    return text ? JSON.parse(text) : null;
  }
}

/** The fields of a refusal; empty if it is not JSON. */
function parsed(text: string): { detail?: unknown; confirm?: unknown } {
  try {
    return JSON.parse(text) as object;
  } catch {
    return {};
  }
}
