import type { WebGLRenderer } from "three";
import { menuIsDown } from "../input/stop-gestures";
import type { Key } from "../page/texts";

const FOVEATION = 0.3;
const WANTED_RATE_HZ = 90;

export interface SessionEvents {
  /** The session starts, and its inputs can be observed. */
  begins(session: XRSession): void;
  entered(): void;
  left(): void;
  /** A select input started. */
  selected(source: XRInputSource, frame: XRFrame): void;
  menuPressed(): void;
  originReset(): void;
  visibilityChanged(): void;
}

/** Starts and ends immersive VR sessions, and reports the participant's inputs. */
export class XRSessionManager {
  private session: XRSession | null = null;
  private menuWasDown = false;

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly events: SessionEvents,
  ) {}

  get presenting(): boolean {
    return this.session !== null;
  }

  async enter(xr: XRSystem): Promise<void> {
    const session = await xr.requestSession("immersive-vr", {
      requiredFeatures: ["local-floor"],
      optionalFeatures: ["hand-tracking"],
    });
    let over = false;
    session.addEventListener("end", () => {
      over = true;
      this.ended();
    });
    session.addEventListener("selectstart", ({ inputSource, frame }) =>
      this.events.selected(inputSource, frame),
    );
    session.addEventListener("visibilitychange", () => this.events.visibilityChanged());
    this.events.begins(session);
    this.renderer.xr.setFoveation(FOVEATION);
    await this.renderer.xr.setSession(session);
    this.renderer.xr.getReferenceSpace()?.addEventListener("reset", () => this.events.originReset());
    await setFrameRate(session);
    console.info(`VR at ${session.frameRate ?? "unknown"} Hz, foveation ${this.renderer.xr.getFoveation()}`);
    if (over) return;
    this.session = session;
    this.events.entered();
  }

  /** The visibility state of the session. */
  get visibility(): XRVisibilityState {
    return this.session?.visibilityState ?? "hidden";
  }

  /** InputProfileMessage profiles and refresh rate of the headset. */
  get hardware(): { profiles: string[]; display_hz: number | null } {
    const profiles = Array.from(this.session?.inputSources ?? [], ({ profiles: [first] }) => first ?? "");
    return { profiles: profiles.filter((profile) => profile).slice(0, 4), display_hz: this.session?.frameRate ?? null };
  }

  leave(): void {
    void this.session?.end();
  }

  /** Vibrates the controller of a hand, if it has an actuator. */
  pulse(hand: XRHandedness, strength: number, ms: number): void {
    for (const source of this.session?.inputSources ?? []) {
      if (source.handedness === hand) void motorOf(source)?.pulse(strength, ms);
    }
  }

  /** Checks the menu button; call it in every frame. */
  watchButtons(sources: XRInputSourceArray): void {
    const down = menuIsDown(sources);
    if (down && !this.menuWasDown) this.events.menuPressed();
    this.menuWasDown = down;
  }

  private ended(): void {
    const had = this.session !== null;
    this.session = null;
    this.menuWasDown = false;
    if (had) this.events.left();
  }
}

/** The reason why VR cannot be entered, or null. */
export async function vrUnavailableReason(): Promise<Key | null> {
  if (!window.isSecureContext) return "insecure";
  if (!navigator.xr) return "no_vr";
  const supported = await navigator.xr.isSessionSupported("immersive-vr").catch(() => false);
  return supported ? null : "no_headset";
}

/** Sets the supported frame rate closest to `WANTED_RATE_HZ`. */
async function setFrameRate(session: XRSession): Promise<void> {
  const rates = Array.from(session.supportedFrameRates ?? []);
  const distance = (rate: number) => Math.abs(rate - WANTED_RATE_HZ);
  const [best] = rates.sort((a, b) => distance(a) - distance(b));
  if (best && best !== session.frameRate)
    await session.updateTargetFrameRate(best).catch(() => console.warn(`${best} Hz was refused`));
}

interface Motor {
  pulse(strength: number, ms: number): Promise<boolean>;
}

/** Haptic actuators of the Gamepad Extensions, which the type definitions lack. */
function motorOf({ gamepad }: XRInputSource): Motor | undefined {
  return (gamepad as { hapticActuators?: Motor[] } | undefined)?.hapticActuators?.[0];
}
