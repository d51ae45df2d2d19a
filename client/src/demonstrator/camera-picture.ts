import { Mesh, MeshBasicMaterial, PlaneGeometry, Quaternion, Vector3, WebGLRenderTarget } from "three";
import type { Object3D, PerspectiveCamera, WebGLRenderer } from "three";
import type { XRPose } from "../generated/messages";

/** Size of the image in pixels: the aspect ratio of the robot's wrist camera. */
const WIDTH = 480;
const HEIGHT = 280;
const WIDTH_M = 0.45;
/** Position of the picture relative to the head, when it appears: to the left, and as far away as the tool. */
const FROM_HEAD_M = new Vector3(-0.4, -0.05, -0.8);

/** The image of the robot's camera on a plane in VR, which keeps its place in the room. */
export class CameraPicture {
  private readonly target = new WebGLRenderTarget(WIDTH, HEIGHT, { samples: 4 });
  readonly mesh = new Mesh(
    new PlaneGeometry(WIDTH_M, (WIDTH_M * HEIGHT) / WIDTH),
    new MeshBasicMaterial({ map: this.target.texture, toneMapped: false }),
  );

  constructor() {
    this.mesh.visible = false;
  }

  get shown(): boolean {
    return this.mesh.visible;
  }

  /** Shows the picture next to the viewing direction of the head; null hides it. */
  show(head: XRPose | null): void {
    this.mesh.visible = head !== null;
    if (!head) return;
    const [[x, y, z], orientation] = head;
    this.mesh.position.copy(FROM_HEAD_M).applyQuaternion(new Quaternion(...orientation)).add({ x, y, z });
    this.mesh.lookAt(x, y, z);
  }

  /** Renders the image, if it is shown and the scene has the camera. */
  render(renderer: WebGLRenderer, scene: Object3D, camera: PerspectiveCamera | null): void {
    if (!this.shown || !camera) return;
    camera.aspect = WIDTH / HEIGHT;
    camera.updateProjectionMatrix();
    const { xr } = renderer;
    const before = renderer.getRenderTarget();
    this.mesh.visible = xr.enabled = false;
    renderer.setRenderTarget(this.target);
    renderer.render(scene, camera);
    renderer.setRenderTarget(before);
    this.mesh.visible = xr.enabled = true;
  }
}
