import "../page/page.css";
import { element } from "../page/dom";
import { FULL_DETAIL, LIGHT_DETAIL } from "../scene/view";
import { DemonstratorApp } from "./app";

const asked = new URLSearchParams(location.search);
const emulated = asked.get("emulate") === "1";
const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const emulator = emulated ? await import("../emulator/emulator") : null;
const device = emulator?.installEmulator(asked.get("headset") ?? "quest-3");

try {
  const app = new DemonstratorApp(token, emulated, emulated ? LIGHT_DETAIL : FULL_DETAIL);
  if (emulator && device) emulator.exposeDevice(app, device);
  app.start();
} catch (error) {
  element("problem").hidden = false;
  element("problem").textContent = String(error);
}
window.addEventListener("hashchange", () => location.reload());
