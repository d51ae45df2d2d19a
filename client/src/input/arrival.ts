/** A ray that moves further than this on the panel has moved onto the target below it, metres. */
export const MOVED_M = 0.02;

interface Point {
  x: number;
  y: number;
}

/** Whether a ray has moved onto a target since the targets appeared. A resting ray is on no target. */
export class Arrival {
  private offer = -1;
  private first: number | null = null;
  private began: Point | null = null;
  private arrived = false;

  /** `within`: whether a motion within the first target counts, or the ray must leave the target. */
  constructor(private readonly within: boolean) {}

  /** The target that the ray has moved onto, or null. `offer`: the number of the targets; `value`: the target below. */
  update(offer: number, value: number | null, at: Point): number | null {
    if (offer !== this.offer) {
      this.offer = offer;
      this.first = value;
      this.began = { x: at.x, y: at.y };
      this.arrived = false;
    }
    const way = this.began ? Math.hypot(at.x - this.began.x, at.y - this.began.y) : 0;
    this.arrived ||= value !== this.first || value === null || (this.within && way > MOVED_M);
    return this.arrived ? value : null;
  }
}
