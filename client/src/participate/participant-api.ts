import type { Language } from "../generated/messages";

/** What the participant does next; see `hosting/stages.py`. */
export type Stage =
  | { type: "consent"; version: string; language: string; text: string; sha256: string }
  | { type: "inclusion"; questions: [id: string, text: string][] }
  | { type: "safety" }
  | { type: "ready"; minutes: number; trials: number; is_open: boolean; problem: string }
  | { type: "waiting"; ahead: number; minutes: number }
  | { type: "session"; path: string; token: string }
  | { type: "ended"; ending: "completed" | "screened_out" | "withdrawn"; code: string; redirect: string };

export interface Progress {
  title: string;
  stage: Stage;
  language: Omit<Language, "type">;
}

export interface Invitation {
  title: string;
  languages: { language: string; name: string }[];
}

/** A request that the server refused. `reason`: of an invitation that cannot be used. */
export class Refusal extends Error {
  constructor(
    readonly status: number,
    message: string,
    readonly reason: string,
  ) {
    super(message);
  }
}

/** Requests of the participant's page to the public server. */
export class ParticipantApi {
  constructor(private readonly token: string) {}

  progress(): Promise<Progress> {
    return this.call("stage") as Promise<Progress>;
  }

  act(action: string, body: object = {}): Promise<unknown> {
    return this.call(action, body);
  }

  async code(): Promise<string> {
    return ((await this.call("code", {})) as { code: string }).code;
  }

  /** Checks an invitation. */
  invitation(token: string): Promise<Invitation> {
    return this.call("invitation", { token }) as Promise<Invitation>;
  }

  /** Names of the recruitment service's parameters. */
  parameters(): Promise<Record<"participant" | "study" | "session", string>> {
    return this.call("settings") as Promise<Record<"participant" | "study" | "session", string>>;
  }

  /** Enrols a participant, and returns their own token. */
  async enrol(body: object): Promise<string> {
    return ((await this.call("participants", body)) as { token: string }).token;
  }

  /** Returns the own token of the participant with this code. */
  async exchange(code: string): Promise<string> {
    return ((await this.call("headset", { code })) as { token: string }).token;
  }

  private async call(path: string, body?: object): Promise<unknown> {
    const headers: Record<string, string> = this.token ? { Authorization: `Bearer ${this.token}` } : {};
    if (body) headers["Content-Type"] = "application/json";
    const posted = body ? { method: "POST", body: JSON.stringify(body) } : {};
    const response = await fetch(`api/${path}`, { ...posted, headers });
    const text = await response.text();
    if (!response.ok) throw refusalOf(response.status, text);
    return text ? JSON.parse(text) : null;
  }
}

function refusalOf(status: number, text: string): Refusal {
  try {
    const { detail, reason } = JSON.parse(text) as { detail?: unknown; reason?: unknown };
    return new Refusal(status, String(detail ?? text), String(reason ?? ""));
  } catch {
    return new Refusal(status, text, "");
  }
}
