import type { HapticAndAudioFeedback } from "../generated/messages";

export type Hand = "left" | "right";

const PULSE = { strength: 0.5, ms: 40 };
/** Two sine tones a fifth apart with an exponential decay. */
const CHIME = { frequenciesHz: [660, 990], gain: 0.05, seconds: 0.35 };

/** Enabled feedback. */
export interface Allowed {
  haptics: boolean;
  sounds: boolean;
}

/** Haptic feedback when a touch begins, and a sound when the robot succeeds. `chimes` is called with each sound. */
export class Senses {
  private readonly touched = { left: false, right: false };
  /** Plays sounds; null before `wake`. */
  audio: AudioContext | null = null;

  constructor(
    private readonly pulse: (hand: Hand, strength: number, ms: number) => void,
    private readonly allowed: () => Allowed,
    private readonly chimes: () => void = () => undefined,
  ) {}

  /** Enables audio; browsers require a call in the handler of a user action. */
  wake(): void {
    if (!("AudioContext" in globalThis)) return;
    this.audio ??= new AudioContext();
    void this.audio.resume().catch(() => undefined);
  }

  take(feedback: HapticAndAudioFeedback): void {
    const { haptics, sounds } = this.allowed();
    this.feel("left", feedback.left_touched, haptics);
    this.feel("right", feedback.right_touched, haptics);
    if (!sounds || feedback.events === 0) return;
    this.chimes();
    this.chime();
  }

  private feel(hand: Hand, touched: boolean, haptics: boolean): void {
    const begins = touched && !this.touched[hand];
    this.touched[hand] = touched;
    if (begins && haptics) this.pulse(hand, PULSE.strength, PULSE.ms);
  }

  private chime(): void {
    const { audio } = this;
    if (audio?.state !== "running") return;
    const ends = audio.currentTime + CHIME.seconds;
    const volume = audio.createGain();
    volume.gain.setValueAtTime(CHIME.gain, audio.currentTime);
    volume.gain.exponentialRampToValueAtTime(1e-4, ends);
    volume.connect(audio.destination);
    for (const hertz of CHIME.frequenciesHz) {
      const tone = new OscillatorNode(audio, { frequency: hertz });
      tone.connect(volume);
      tone.start();
      tone.stop(ends);
    }
  }
}
