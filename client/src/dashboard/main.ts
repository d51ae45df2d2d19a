import "./dashboard.css";
import { Dashboard } from "./dashboard-page";
import { Live } from "./live-session";
import { Study } from "./study-api";

const REFRESH_MS = 5000;

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const dashboard = new Dashboard(new Study(token));

/** The page `participants` of a host. The host's own page leads the sessions. */
const isHosted = location.pathname.endsWith("/participants");
document.body.classList.toggle("hosted", isHosted);
if (!isHosted)
  new Live(token, {
    changed: () => void dashboard.refresh(),
    problem: (words) => dashboard.refuse(words),
  }).start();
void dashboard.refresh();
setInterval(() => document.hidden || void dashboard.refresh(), REFRESH_MS);
window.addEventListener("hashchange", () => location.reload());
