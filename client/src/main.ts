import "./page.css";
import { App } from "./app";

const emulated = new URLSearchParams(location.search).get("emulate") === "1";
const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const emulator = emulated ? await import("./emulator") : null;
const device = emulator?.installEmulator();

const app = new App(token, emulated);
if (emulator && device) emulator.exposeEmulator(app, device);
app.start();
window.addEventListener("hashchange", () => location.reload());
