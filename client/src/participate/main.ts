import "./participate.css";
import { createElement, element } from "../page/dom";
import { initialTexts, Texts, type Key } from "../page/texts";
import { codeForm, enrolmentForm } from "./enrolment";
import { ParticipantApi, Refusal, type Progress } from "./participant-api";
import { stageElements } from "./stage-view";

const REFRESH_MS = 3000;
const SURE_MS = 6000;
const TOKEN = "avrgym-participant";
const REASONS = ["unknown", "expired", "full", "closed", "duplicate"] as const;

/** The participant's own page: from the invitation to the code at the end. */
class ParticipatePage {
  private texts = initialTexts(navigator.languages);
  private api = new ParticipantApi("");
  private shown = "";
  private readonly asked = new URLSearchParams(location.search);

  async start(): Promise<void> {
    const given = new URLSearchParams(location.hash.slice(1));
    const invitation = given.get("invitation") ?? "";
    const token = given.get("participant") ?? (invitation ? "" : (sessionStorage.getItem(TOKEN) ?? ""));
    this.texts.applyTo(document);
    this.confirm("withdraw", "withdrawal");
    this.confirm("delete", "deletion");
    element("copy").addEventListener("click", () => void this.requestCopy());
    if (token) this.open(token);
    else if (invitation) await this.invite(invitation);
    else this.show([createElement("p", this.texts.get("host_need_link")), codeForm(this.texts, (code) => void this.exchange(code))]);
  }

  /** Shows the page of a participant. The token is in the fragment, and the ids of a recruitment service disappear. */
  private open(token: string): void {
    sessionStorage.setItem(TOKEN, token);
    const emulated = this.asked.get("emulate") === "1" ? "?emulate=1" : "";
    history.replaceState(null, "", `${location.pathname}${emulated}#participant=${token}`);
    this.api = new ParticipantApi(token);
    void this.refresh();
    setInterval(() => document.hidden || void this.refresh(), REFRESH_MS);
  }

  private async invite(token: string): Promise<void> {
    await this.attempt(async () => {
      const invitation = await this.api.invitation(token);
      element("title").textContent = document.title = invitation.title;
      const words = createElement("p", this.texts.get("host_invited", { title: invitation.title }));
      this.show([words, enrolmentForm(invitation, this.texts, (values) => void this.enrol(token, values))]);
    });
  }

  private async enrol(token: string, values: object): Promise<void> {
    await this.attempt(async () => {
      const names = await this.api.parameters();
      const ids = Object.entries(names).map(([kind, name]) => [kind, this.asked.get(name) ?? ""]);
      this.open(await this.api.enrol({ token, ...values, ...(Object.fromEntries(ids) as object) }));
    });
  }

  private async exchange(code: string): Promise<void> {
    await this.attempt(async () => this.open(await this.api.exchange(code)));
  }

  private async refresh(): Promise<void> {
    await this.attempt(async () => this.showProgress(await this.api.progress()));
  }

  private showProgress(progress: Progress): void {
    const seen = JSON.stringify(progress);
    if (seen === this.shown) return;
    this.shown = seen;
    const { language, direction, texts } = progress.language;
    this.texts = new Texts(language, direction, texts);
    this.texts.applyTo(document);
    element("title").textContent = document.title = progress.title;
    element("own").hidden = progress.stage.type === "ended" && progress.stage.ending !== "completed";
    element("withdraw").hidden = progress.stage.type === "ended";
    this.show(
      stageElements(progress.stage, this.texts, {
        act: (action, body) => void this.act(action, body),
        showCode: (place) => void this.showCode(place),
      }),
    );
  }

  private async act(action: string, body?: object): Promise<void> {
    await this.attempt(async () => {
      await this.api.act(action, body);
      await this.refresh();
    });
  }

  private async showCode(place: HTMLElement): Promise<void> {
    await this.attempt(async () => {
      const code = (await this.api.code()).replace(/(\d{4})/, "$1 ");
      place.textContent = this.texts.get("host_use_code", { address: location.host, code });
    });
  }

  private async requestCopy(): Promise<void> {
    await this.attempt(async () => {
      await this.api.act("copy");
      element("copy").textContent = this.texts.get("host_copy_requested");
    });
  }

  /** A button that acts when it is chosen twice. */
  private confirm(id: "withdraw" | "delete", action: string): void {
    const chosen = element<HTMLButtonElement>(id);
    const key: Key = `host_${id}`;
    chosen.addEventListener("click", () => {
      if (chosen.dataset["sure"] === "1") {
        void this.act(action);
        return;
      }
      chosen.dataset["sure"] = "1";
      chosen.textContent = this.texts.get("host_sure");
      setTimeout(() => {
        delete chosen.dataset["sure"];
        chosen.textContent = this.texts.get(key);
      }, SURE_MS);
    });
  }

  private async attempt(work: () => Promise<void> | void): Promise<void> {
    const problem = element("problem");
    try {
      await work();
      problem.hidden = true;
    } catch (error) {
      problem.hidden = false;
      problem.textContent = this.explain(error);
    }
  }

  private explain(error: unknown): string {
    if (!(error instanceof Refusal)) return this.texts.get("lost");
    const reason = REASONS.find((each) => each === error.reason);
    if (reason) return this.texts.get(`host_${reason}`);
    if (error.status === 401) {
      sessionStorage.removeItem(TOKEN);
      return this.texts.get("host_need_link");
    }
    return error.message;
  }

  private show(elements: HTMLElement[]): void {
    element("stage").replaceChildren(...elements);
  }
}

void new ParticipatePage().start();
window.addEventListener("hashchange", () => location.reload());
