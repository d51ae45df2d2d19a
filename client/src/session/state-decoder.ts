import { JOINT_STEPS, POSE_STEPS, type WorldStateChange } from "../generated/messages";

/** The state of the world at one time; its arrays are reused for the next state. */
export interface WorldState extends Omit<WorldStateChange, "type" | "joint_targets" | "poses"> {
  /** SelectionTarget angles of the person's joints, radians. */
  joint_targets: Float64Array;
  /** x, y, z, w, x, y, z of each body, then of each mark, in the world frame. */
  poses: Float32Array;
}

/** Decoder of delta-encoded states; the server's encoder is `vr/protocol/state_encoding.py`. */
export class StateDecoder {
  private targets = new DeltaRows(JOINT_STEPS);
  private poses = new DeltaRows(POSE_STEPS);

  /** Resets after a scene message. */
  beginScene(): void {
    this.targets = new DeltaRows(JOINT_STEPS);
    this.poses = new DeltaRows(POSE_STEPS);
  }

  decode({ sequence, simulation_time_s, tracking_sequence, deviating_parts, joint_targets, poses }: WorldStateChange): WorldState {
    return {
      ...{ sequence, simulation_time_s, tracking_sequence, deviating_parts },
      joint_targets: this.targets.changedBy(joint_targets),
      poses: this.numbers(this.poses.changedBy(poses)),
    };
  }

  private single = new Float32Array();

  /** Converts to single precision for three.js. */
  private numbers(poses: Float64Array): Float32Array {
    if (this.single.length !== poses.length) this.single = new Float32Array(poses.length);
    this.single.set(poses);
    return this.single;
  }
}

/** Decodes rows of numbers from differences in whole steps, without drift. */
class DeltaRows {
  private whole = new Float64Array();
  private numbers = new Float64Array();

  constructor(private readonly steps: readonly number[]) {}

  changedBy(packed: Uint8Array): Float64Array {
    const { steps } = this;
    const varints = new Varints(packed);
    for (let row = 0; !varints.done; row++) {
      row += varints.next();
      this.reserve((row + 1) * steps.length);
      for (let column = 0; column < steps.length; column++) {
        const at = row * steps.length + column;
        this.whole[at]! += zigzag(varints.next());
        this.numbers[at] = this.whole[at]! * steps[column]!;
      }
    }
    return this.numbers;
  }

  /** Only the first state after a scene has new rows. */
  private reserve(length: number): void {
    if (length <= this.whole.length) return;
    this.whole = extended(this.whole, length);
    this.numbers = extended(this.numbers, length);
  }
}

/** Decodes varints as in Protocol Buffers. */
class Varints {
  private at = 0;

  constructor(private readonly bytes: Uint8Array) {}

  get done(): boolean {
    return this.at >= this.bytes.length;
  }

  /** Uses multiplication, because numbers may exceed 32 bits. */
  next(): number {
    for (let value = 0, scale = 1; ; scale *= 128) {
      const byte = this.bytes[this.at++]!;
      value += (byte & 127) * scale;
      if (!(byte & 128)) return value;
    }
  }
}

function zigzag(number: number): number {
  return number % 2 ? -(number + 1) / 2 : number / 2;
}

function extended(numbers: Float64Array, length: number): Float64Array<ArrayBuffer> {
  const longer = new Float64Array(length);
  longer.set(numbers);
  return longer;
}
