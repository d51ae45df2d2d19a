import type { InputProfileMessage, OfferedTargets, TargetSelectionRequest, SelectionTarget } from "../generated/messages";
import { Arrival } from "./arrival";
import { Dwell } from "./dwell";
import { CONTROLLERS, kindOfProfile, type Switch } from "./input-profile";
import { Scanner } from "./scanner";

const NOWHERE = { x: 0, y: 0 };
/** With reduced motion, rings fill in this number of steps. */
const REDUCED_STEPS = 4;

/**
 * The targets that are offered to the participant, the highlighted one, and the selected one.
 *
 * Every source feeds it: rays, dwell, switches and the experimenter. Panel and page only offer targets and act on the
 * selected one.
 */
export class Selection {
  profile: InputProfileMessage = CONTROLLERS;
  /** Increases with each offer. */
  number = 0;
  targets: readonly SelectionTarget[] = [];
  /** Whether the participant has moved the highlight by a switch since the targets appeared. */
  stepped = false;
  private key = "";
  private pointed: number | null = null;
  private dwell = new Dwell(1000 * CONTROLLERS.dwell_s);
  private arrival = new Arrival(false);
  private scanner = new Scanner(null);

  /** `select` acts on a target. `announce` sends an offer to the experimenter. */
  constructor(
    private readonly select: (value: number) => void,
    private readonly announce: (offered: OfferedTargets) => void,
  ) {}

  /** The highlighted target, or null. */
  get highlighted(): number | null {
    const kind = kindOfProfile(this.profile);
    if (kind === "dwell") return this.dwell.highlighted;
    if (kind === "scan" || kind === "step") return this.scanner.highlighted;
    return kind === "remote" ? null : this.pointed;
  }

  /** The share of the time for which the highlighted target has been looked at, 0 to 1. */
  get progress(): number {
    if (kindOfProfile(this.profile) !== "dwell") return 0;
    const { progress } = this.dwell;
    return this.profile.presentation.reduced_motion ? Math.floor(progress * REDUCED_STEPS) / REDUCED_STEPS : progress;
  }

  /** Changes the profile; nothing that was begun with another one goes on. */
  change(profile: InputProfileMessage, nowMs: number): void {
    if (JSON.stringify(profile) === JSON.stringify(this.profile)) return;
    this.profile = profile;
    this.dwell = new Dwell(1000 * profile.dwell_s);
    this.scanner = new Scanner(profile.method === "one-switch" ? 1000 * profile.scan_s : null);
    this.offer(this.targets, `${this.key}'`, nowMs);
  }

  /** Offers targets. `key` identifies them: with the same key, a look or scan that has begun goes on. */
  offer(targets: readonly SelectionTarget[], key: string, nowMs: number): void {
    if (key === this.key) return;
    this.key = key;
    this.targets = targets;
    this.number++;
    this.pointed = null;
    this.stepped = false;
    this.dwell.reset();
    this.scanner.offer(this.values, nowMs);
    this.announceOffer();
  }

  /** Sends the offer to an experimenter who selects for the participant. */
  announceOffer(): void {
    const { number, targets } = this;
    if (kindOfProfile(this.profile) === "remote") this.announce({ type: "offered", number, targets: [...targets] });
  }

  private get values(): number[] {
    return this.targets.map(({ value }) => value);
  }

  /** Points at a target with a ray; null: at none. */
  point(value: number | null): void {
    this.pointed = value;
  }

  /** Looks at a target with the head, or rests the pointer on it. */
  look(value: number | null, nowMs: number): void {
    const onto = this.arrival.update(this.number, value, NOWHERE);
    this.act(this.dwell.look(onto, nowMs));
  }

  /** Moves the highlight of a scan when it is due; `held`: it stays, as while a text is read aloud. */
  tick(nowMs: number, held = false): void {
    if (held) this.scanner.hold(nowMs);
    else this.scanner.tick(nowMs);
  }

  /** The label of the highlighted target, or an empty one. */
  get highlightedLabel(): string {
    return this.targets.find(({ value }) => value === this.highlighted)?.label ?? "";
  }

  /** Presses a switch. */
  press(which: Switch, nowMs: number): void {
    if (which === "select") this.act(this.scanner.select(nowMs));
    else {
      this.scanner.step();
      this.stepped = true;
    }
  }

  /** The experimenter selects a target of an offer; later offers make it invalid. */
  pressRemotely({ number, value }: Pick<TargetSelectionRequest, "number" | "value">): void {
    if (number === this.number && this.values.includes(value)) this.act(value);
  }

  private act(value: number | null): void {
    if (value !== null) this.select(value);
  }
}
