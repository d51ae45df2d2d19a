import { Group } from "three";
import type { Panel } from "./panel";
import { Pointer } from "./pointer";

/** The rays of input sources: each source that points has its own, whatever its hand and the kind of its ray. */
export class Pointers {
  readonly group = new Group();
  private readonly pointers = new Map<XRInputSource, Pointer>();
  private readonly spare: Pointer[] = [];
  private latest: Pointer | null = null;

  /** Aims all sources that point; returns the button that one of them came to last, or null. */
  point(frame: XRFrame, space: XRReferenceSpace, panel: Panel): number | null {
    const sources = Array.from(frame.session.inputSources);
    for (const source of this.pointers.keys()) if (!sources.includes(source)) this.release(source);
    for (const source of sources) if (pointsAlways(source)) this.aim(source, frame, space, panel);
    if (this.latest && this.latest.value !== null) return this.latest.value;
    return [...this.pointers.values()].find(({ value }) => value !== null)?.value ?? null;
  }

  /** The button that a source points at while it is being selected, or null. */
  pointedAt(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace, panel: Panel): number | null {
    const value = this.aim(source, frame, space, panel);
    if (!pointsAlways(source)) this.of(source).value = null;
    return value;
  }

  hide(): void {
    for (const source of [...this.pointers.keys()]) this.release(source);
  }

  private aim(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace, panel: Panel): number | null {
    const pointer = this.of(source);
    const before = pointer.value;
    const pose = frame.getPose(source.targetRaySpace, space);
    if (pose) pointer.aim(pose.transform, panel, beginsAtHand(source));
    else pointer.hide();
    if (pointer.value !== null && pointer.value !== before) this.latest = pointer;
    return pointer.value;
  }

  private of(source: XRInputSource): Pointer {
    const had = this.pointers.get(source);
    if (had) return had;
    const pointer = this.spare.pop() ?? new Pointer();
    this.group.add(pointer.group);
    this.pointers.set(source, pointer);
    return pointer;
  }

  private release(source: XRInputSource): void {
    const pointer = this.pointers.get(source)!;
    this.pointers.delete(source);
    pointer.hide();
    this.spare.push(pointer);
  }
}

/** A transient pointer follows the hand once it is selected, and a touch its finger: both point as they begin. */
function pointsAlways({ targetRayMode }: XRInputSource): boolean {
  return targetRayMode !== "transient-pointer" && targetRayMode !== "screen";
}

/** All other rays begin at the eyes: of these only the end is drawn. */
function beginsAtHand({ targetRayMode }: XRInputSource): boolean {
  return targetRayMode === "tracked-pointer";
}
