import "./page.css";
import { App } from "./app";
import { element } from "./dom";
import { CannotDrawError, FULL_DETAIL, LIGHT_DETAIL } from "../scene/view";
import { ENGLISH_TEXTS, initialTexts } from "./texts";

const asked = new URLSearchParams(location.search);
const emulated = asked.get("emulate") === "1";
const wanted = asked.get("detail") ?? (emulated ? "light" : "full");
const detail = wanted === "light" ? LIGHT_DETAIL : FULL_DETAIL;
const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const emulator = emulated ? await import("../emulator/emulator") : null;
const device = emulator?.installEmulator(asked.get("headset") ?? "quest-3");

const isSpectator = location.pathname.endsWith("/spectator");

function sayWhyNothingIsDrawn(error: unknown): void {
  if (!(error instanceof CannotDrawError)) throw error;
  const texts = isSpectator ? ENGLISH_TEXTS : initialTexts(navigator.languages);
  texts.applyTo(document);
  for (const id of ["loading", "status", "take-part", "help"]) element(id).hidden = true;
  element("problem").hidden = false;
  element("problem").textContent = texts.get("no_drawing");
}

const isHosted = !isSpectator && location.pathname.includes("/session/");
element("own-page").hidden = !isHosted;
document.body.classList.toggle("hosted", isHosted);
document.body.classList.toggle("embedded", asked.get("embedded") === "1");

try {
  const app = new App(token, emulated, detail, isSpectator);
  if (emulator && device) emulator.exposeEmulator(app, device);
  app.start();
} catch (error) {
  sayWhyNothingIsDrawn(error);
}
window.addEventListener("hashchange", () => location.reload());
