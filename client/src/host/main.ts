import "../participate/participate.css";
import "./host.css";
import { createElement, element } from "../page/dom";
import { button } from "../participate/stage-view";

const REFRESH_MS = 2000;

/** A running session; see `hosting/experimenter_app.py`. */
interface Session {
  id: string;
  participant: string;
  state: string;
  phase: string;
  trial: number;
  trials: number;
  connected: boolean;
  paused: boolean;
  minutes: number;
  latency_ms: number | null;
  untracked_share: number;
  missed_ticks: number;
  crashes: number;
  warnings: string[];
}

interface View {
  title: string;
  is_open: boolean;
  capacity: number;
  missed_share: number;
  waiting: number;
  participants: Record<string, number>;
  problems: string[];
  copies_requested: string[];
  sessions: Session[];
}

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";

/** The experimenter's page of all sessions. */
class HostPage {
  private view: View | null = null;

  start(): void {
    element<HTMLAnchorElement>("participants").href = `./participants#token=${token}`;
    element("door").addEventListener("click", () => void this.post("door", { is_open: !this.view?.is_open }));
    void this.refresh();
    setInterval(() => document.hidden || void this.refresh(), REFRESH_MS);
  }

  private async refresh(): Promise<void> {
    const response = await this.fetch("sessions");
    if (response) this.show((await response.json()) as View);
  }

  private async post(path: string, body: object = {}): Promise<void> {
    if (await this.fetch(path, body)) await this.refresh();
  }

  private async fetch(path: string, body?: object): Promise<Response | null> {
    const headers: Record<string, string> = { Authorization: `Bearer ${token}` };
    if (body) headers["Content-Type"] = "application/json";
    const posted = body ? { method: "POST", body: JSON.stringify(body) } : {};
    const response = await fetch(`api/${path}`, { ...posted, headers }).catch(() => null);
    const refused = element("refused");
    refused.hidden = response?.ok ?? false;
    if (!response) refused.textContent = "The host cannot be reached. Trying again …";
    else if (!response.ok) refused.textContent = await reasonOf(response);
    return response?.ok ? response : null;
  }

  private show(view: View): void {
    this.view = view;
    element("title").textContent = document.title = view.title;
    const states = Object.entries(view.participants).map(([state, count]) => `${count} ${state}`);
    element("summary").textContent = [
      `${view.sessions.length} of ${view.capacity} sessions`,
      `${view.waiting} wait`,
      `${(100 * view.missed_share).toFixed(2)} % of ticks given up`,
      ...states,
      ...(view.copies_requested.length ? [`copies of data requested: ${view.copies_requested.join(", ")}`] : []),
    ].join(" · ");
    element("problems").replaceChildren(...view.problems.map((each) => createElement("li", each)));
    element("door-words").textContent = view.is_open
      ? "The study accepts participants and starts sessions."
      : "The door is closed: no new participants and no new sessions. Running sessions continue.";
    element("door").textContent = view.is_open ? "Close the door" : "Open the door";
    element("none").hidden = view.sessions.length > 0;
    this.showSessions(view.sessions);
  }

  /** Updates the rows in place, so that an open message is not lost. */
  private showSessions(sessions: Session[]): void {
    const list = element("sessions");
    const wanted = new Set(sessions.map((each) => each.id));
    for (const row of [...list.children]) if (!wanted.has((row as HTMLElement).dataset["id"]!)) row.remove();
    for (const session of sessions) {
      let row = [...list.children].find((each) => (each as HTMLElement).dataset["id"] === session.id) as HTMLElement;
      if (!row) {
        row = this.row(session);
        list.append(row);
      }
      fill(row, session);
    }
  }

  private row(session: Session): HTMLElement {
    const row = createElement("li");
    row.dataset["id"] = session.id;
    const path = `sessions/${session.id}`;
    const open = createElement("a", "Open");
    Object.assign(open, { href: `session/${session.id}/spectator#token=${token}`, target: "_blank", rel: "noopener", className: "button" });
    open.setAttribute("aria-label", `Open the session of ${session.participant}`);
    const buttons = createElement("div");
    buttons.className = "buttons";
    const pause = button("Pause", () => void this.post(`${path}/${pause.dataset["command"]}`), "quiet");
    pause.dataset["role"] = "pause";
    const end = button("End session", () => void this.post(`${path}/end`), "quiet");
    buttons.append(open, button("Stop the robot", () => void this.post(`${path}/stop`), "alarm"), pause, end, this.messageForm(session));
    const list = createElement("ul");
    list.className = "warnings";
    row.append(createElement("h3", session.participant), createElement("p"), list, buttons);
    return row;
  }

  private messageForm(session: Session): HTMLElement {
    const form = createElement("form");
    const text = createElement("input");
    Object.assign(text, { maxLength: 200, required: true, placeholder: "Message to the participant" });
    text.setAttribute("aria-label", `Message to ${session.participant}`);
    const send = createElement("button", "Send");
    send.className = "quiet";
    form.append(text, send);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.post(`sessions/${session.id}/message`, { text: text.value }).then(() => (text.value = ""));
    });
    return form;
  }
}

function fill(row: HTMLElement, session: Session): void {
  const [, words, warnings] = row.children as unknown as HTMLElement[];
  words!.textContent = [
    `${session.phase.replaceAll("_", " ")}${session.paused ? " (paused)" : ""}`,
    `trial ${session.trial} of ${session.trials}`,
    `${session.minutes.toFixed(0)} min`,
    session.latency_ms === null ? "latency –" : `latency ${session.latency_ms.toFixed(0)} ms`,
    `untracked ${(100 * session.untracked_share).toFixed(1)} %`,
    `${session.missed_ticks} ticks given up`,
  ].join(" · ");
  warnings!.replaceChildren(...session.warnings.map((each) => createElement("li", each)));
  const pause = row.querySelector<HTMLButtonElement>("[data-role=pause]")!;
  pause.textContent = session.paused ? "Continue" : "Pause";
  pause.dataset["command"] = session.paused ? "continue" : "pause";
}

async function reasonOf(response: Response): Promise<string> {
  const text = await response.text();
  try {
    return String((JSON.parse(text) as { detail?: unknown }).detail ?? text);
  } catch {
    return text;
  }
}

new HostPage().start();
window.addEventListener("hashchange", () => location.reload());
