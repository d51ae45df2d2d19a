import type { Overview } from "./study-api";
import { element } from "../page/dom";

/** Shows the link and the code of the running session. */
export function showLink(link: Overview["link"]): void {
  element("link").hidden = link === null;
  if (!link) return;
  element("link-code").textContent = formatCode(link.code);
  const addresses = link.addresses.map((each) => new URL(each, location.origin).href);
  const list = element("link-addresses");
  const shown = [...list.querySelectorAll("code")].map((each) => each.textContent);
  if (shown.join() === addresses.join()) return;
  list.replaceChildren(...addresses.map(addressLine));
}

/** A code in two groups of digits. */
export function formatCode(code: string): string {
  return `${code.slice(0, 3)} ${code.slice(3)}`;
}

function addressLine(address: string): HTMLLIElement {
  const item = document.createElement("li");
  const text = document.createElement("code");
  const copy = document.createElement("button");
  text.textContent = address;
  Object.assign(copy, { type: "button", className: "small", textContent: "Copy" });
  copy.setAttribute("aria-label", `Copy the link on ${new URL(address).hostname}`);
  copy.addEventListener("click", () => void navigator.clipboard.writeText(address));
  item.append(text, " ", copy);
  return item;
}
