import { Matrix4, Quaternion, Vector3 } from "three";
import { P_DEVICE, P_SESSION, P_SPACE, XRInputSource, XRInputSourceEvent, XRSpace, type XRDevice, type XRFrame } from "iwer";

const FORWARD = new Vector3(0, 0, -1);
/** Direction of a pinching hand after its start: downwards. */
const DOWN = new Vector3(0, -1, 0);
const ONE = new Vector3(1, 1, 1);

type Step = "away" | "there" | "selected" | "released";

/**
 * An input source that IWER lacks. A pinch points along the gaze when it starts, then along the hand, and exists
 * only during the pinch. A gaze always points and selects with a button.
 */
export class EmulatedPointer {
  private step: Step = "away";
  private wanted = false;
  private target = new Vector3(0, 0, -1);
  private ray: XRSpace;
  inputSource: XRInputSource;

  constructor(
    private readonly device: XRDevice,
    private readonly mode: "transient-pointer" | "gaze",
  ) {
    this.ray = new XRSpace(device[P_DEVICE].globalSpace);
    this.inputSource = this.source();
    const inherited = Object.getOwnPropertyDescriptor(Object.getPrototypeOf(device), "activeInputs")!.get!;
    Object.defineProperty(device, "activeInputs", {
      get: () => [...inherited.call(device), ...(this.connected ? [this] : [])],
    });
  }

  get connected(): boolean {
    return this.mode === "gaze" || this.step !== "away" || this.wanted;
  }

  /** Sets the point at which the participant looks. */
  lookAt(point: Vector3): void {
    this.target.copy(point);
    if (this.mode === "gaze") turnTo(this.device, point);
  }

  press(pressed: boolean): void {
    this.wanted = pressed;
  }

  /** Called by IWER in every frame; makes one step of a pinch per frame, as browsers do. */
  onFrameStart(frame: XRFrame): void {
    if (this.mode === "gaze") frame.session[P_SESSION].hasGazeTracking = true;
    this.aim();
    const send = (type: string) =>
      frame.session.dispatchEvent(new XRInputSourceEvent(type, { frame, inputSource: this.inputSource }));
    if (this.step === "away" && this.wanted) this.appear();
    else if (this.step === "there") {
      this.step = "selected";
      send("selectstart");
    } else if (this.step === "selected" && !this.wanted) {
      this.step = "released";
      send("select");
      send("selectend");
    } else if (this.step === "released") this.step = "away";
  }

  private appear(): void {
    this.step = "there";
    if (this.mode === "gaze") return;
    this.ray = new XRSpace(this.device[P_DEVICE].globalSpace);
    this.inputSource = this.source();
    this.aim();
  }

  private aim(): void {
    const { position, quaternion } = this.device;
    const eyes = new Vector3(position.x, position.y, position.z);
    const direction =
      this.mode === "gaze"
        ? FORWARD.clone().applyQuaternion(new Quaternion(quaternion.x, quaternion.y, quaternion.z, quaternion.w))
        : this.step === "selected" || this.step === "released"
          ? DOWN
          : this.target.clone().sub(eyes).normalize();
    const turn = new Quaternion().setFromUnitVectors(FORWARD, direction);
    Object.assign(this.ray[P_SPACE].offsetMatrix, new Matrix4().compose(eyes, turn, ONE).elements);
  }

  private source(): XRInputSource {
    const profiles = this.mode === "gaze" ? ["generic-button"] : ["generic-hand-select", "generic-hand"];
    return new XRInputSource("none" as never, this.mode as never, profiles, this.ray);
  }
}

/** Turns a pose towards a point. */
export function turnTo({ position, quaternion }: Pick<XRDevice, "position" | "quaternion">, point: Vector3): void {
  const from = new Vector3(position.x, position.y, position.z);
  const turned = new Quaternion().setFromRotationMatrix(new Matrix4().lookAt(from, point, new Vector3(0, 1, 0)));
  quaternion.set(turned.x, turned.y, turned.z, turned.w);
}
