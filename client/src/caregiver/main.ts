import "../dashboard/dashboard.css";
import "./caregiver.css";
import { RobotCommandInput } from "../input/robot-commands";
import { element, spectatorFrame, watchAddress } from "../page/dom";
import { ENGLISH_TEXTS, textsOf, type Texts } from "../page/texts";
import { Connection, type Link } from "../session/connection";
import { linkText } from "../session/display-state";
import type { ServerMessage } from "../generated/messages";
import { questionFields, type CaregiverItem } from "./questions";

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const authorization = { Authorization: `Bearer ${token}` };

/** The caregiver's page: the view of the session, commands to the robot, and the caregiver's own questions. */
class CaregiverPage {
  private texts: Texts = ENGLISH_TEXTS;
  private readonly connection: Connection;
  private readonly commands: RobotCommandInput;
  private shownAt = 0;

  constructor() {
    this.connection = new Connection(watchAddress(), token, false, {
      message: (message) => this.receive(message),
      link: (link, code) => this.onLink(link, code),
    });
    this.commands = new RobotCommandInput(element("robot-commands"), (message) => this.connection.send(message), "caregiver");
    element("stop").addEventListener("click", () => this.stop());
    window.addEventListener("keydown", (event) => this.key(event));
  }

  start(): void {
    this.connection.open();
  }

  private receive(message: ServerMessage): void {
    if (message.type === "welcome") this.onWelcome();
    if (message.type === "language") this.speak(textsOf(message));
    if (message.type === "phase") element("phase").textContent = message.page_text || message.text;
    if (message.type === "robot_commands") this.commands.show(message);
  }

  private onWelcome(): void {
    if (!document.querySelector("iframe")) element("picture").append(spectatorFrame(element("scene-heading").textContent!, token));
    void this.loadQuestions();
  }

  private speak(texts: Texts): void {
    this.texts = texts;
    texts.applyTo(document);
  }

  private onLink(link: Link, code: number): void {
    element("server").textContent = linkText({ texts: this.texts, link, code });
    element("server").dataset["link"] = link;
  }

  private stop(): void {
    this.connection.send({ type: "robot_command", name: "stop", source: "caregiver", client_time_ms: performance.now() });
  }

  private key(event: KeyboardEvent): void {
    if (event.key === "Escape" && !event.repeat) this.stop();
    else this.commands.takesKey(event);
  }

  private async loadQuestions(): Promise<void> {
    const response = await fetch("study/care/items", { headers: authorization });
    if (!response.ok) return;
    const items = (await response.json()) as CaregiverItem[];
    this.shownAt = performance.now();
    element("questions-part").hidden = items.length === 0;
    element("questions").replaceChildren(...questionFields(items, (item, value) => void this.answer(item, value)));
  }

  private async answer(item: string, value: number): Promise<void> {
    const body = JSON.stringify({ item, value, response_time_s: (performance.now() - this.shownAt) / 1000 });
    const headers = { ...authorization, "Content-Type": "application/json" };
    const response = await fetch("study/care/answers", { method: "POST", headers, body }).catch(() => null);
    element("answered").textContent = this.texts.get(response?.ok ? "care_stored" : "care_failed");
  }
}

new CaregiverPage().start();
window.addEventListener("hashchange", () => location.reload());
