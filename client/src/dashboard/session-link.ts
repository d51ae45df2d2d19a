import type { Overview } from "./study-api";
import { element } from "../page/dom";

/** Shows the link and the code of the running session. */
export function showLink(link: Overview["link"]): void {
  element("link").hidden = link === null;
  if (!link) return;
  element("link-code").textContent = formatCode(link.code);
  showAddresses("link-addresses", link.addresses);
}

/** Shows the addresses of the caregiver's page, if a session has run. */
export function showCaregiverLink(addresses: readonly string[]): void {
  element("caregiver-link").hidden = addresses.length === 0;
  showAddresses("caregiver-addresses", addresses);
}

function showAddresses(id: string, given: readonly string[]): void {
  const addresses = given.map((each) => new URL(each, location.origin).href);
  const list = element(id);
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
