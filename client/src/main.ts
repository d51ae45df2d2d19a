import "./page.css";
import { App } from "./app";
import { FULL_DETAIL, LIGHT_DETAIL } from "./view";

const asked = new URLSearchParams(location.search);
const emulated = asked.get("emulate") === "1";
const wanted = asked.get("detail") ?? (emulated ? "light" : "full");
const detail = wanted === "light" ? LIGHT_DETAIL : FULL_DETAIL;
const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const emulator = emulated ? await import("./emulator") : null;
const device = emulator?.installEmulator();

const watches = location.pathname.endsWith("/spectator");

document.body.classList.toggle("embedded", asked.get("embedded") === "1");

const app = new App(token, emulated, detail, watches);
if (emulator && device) emulator.exposeEmulator(app, device);
app.start();
window.addEventListener("hashchange", () => location.reload());
