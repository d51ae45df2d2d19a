import { JOINT_STEPS, POSE_STEPS, type StateChange } from "../generated/messages";

/** The world at one instant; its numbers hold until the next state is decoded. */
export interface State extends Omit<StateChange, "type" | "joint_targets" | "poses"> {
  /** Angles that the person's joints are driven to, radians. */
  joint_targets: Float64Array;
  /** x, y, z, then w, x, y, z of each body, then of each mark; the simulation's frame. */
  poses: Float32Array;
}

/** The client's end of a connection over which states come as changes; the server's is `vr/protocol/state_encoding.py`. */
export class StateDecoder {
  private targets = new DeltaRows(JOINT_STEPS);
  private poses = new DeltaRows(POSE_STEPS);

  /** After a scene, states differ from nothing. */
  beginScene(): void {
    this.targets = new DeltaRows(JOINT_STEPS);
    this.poses = new DeltaRows(POSE_STEPS);
  }

  decode({ sequence, simulation_time_s, tracking_sequence, held, joint_targets, poses }: StateChange): State {
    return {
      ...{ sequence, simulation_time_s, tracking_sequence, held },
      joint_targets: this.targets.changedBy(joint_targets),
      poses: this.numbers(this.poses.changedBy(poses)),
    };
  }

  private single = new Float32Array();

  /** three takes them as they are drawn: in single precision. */
  private numbers(poses: Float64Array): Float32Array {
    if (this.single.length !== poses.length) this.single = new Float32Array(poses.length);
    this.single.set(poses);
    return this.single;
  }
}

/** Rows of numbers as they were told last: in whole steps, so that nothing drifts, and what these amount to. */
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

  /** Only the first state after a scene brings rows that were not there. */
  private reserve(length: number): void {
    if (length <= this.whole.length) return;
    this.whole = extended(this.whole, length);
    this.numbers = extended(this.numbers, length);
  }
}

/** Whole numbers, the lowest seven bits first, as Protocol Buffers write them. */
class Varints {
  private at = 0;

  constructor(private readonly bytes: Uint8Array) {}

  get done(): boolean {
    return this.at >= this.bytes.length;
  }

  /** Numbers of more than 32 bits come too, which shifts would cut. */
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
