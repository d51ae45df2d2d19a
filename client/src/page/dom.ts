/** The element of the page with this id, which must exist. */
export function element<T extends Element = HTMLElement>(id: string): T {
  return document.getElementById(id) as unknown as T;
}

/** A new element with this text. */
export function createElement<K extends keyof HTMLElementTagNameMap>(name: K, text = ""): HTMLElementTagNameMap[K] {
  const element = document.createElement(name);
  element.textContent = text;
  return element;
}

/** A frame with the spectator page. */
export function spectatorFrame(title: string, token: string): HTMLIFrameElement {
  const frame = createElement("iframe");
  const asked = new URLSearchParams(location.search);
  asked.set("embedded", "1");
  frame.title = title;
  frame.src = `spectator?${asked}#token=${token}`;
  return frame;
}

/** The address of the WebSocket for pages that watch the session. */
export function watchAddress(): string {
  const address = new URL("watch", location.origin + location.pathname);
  address.protocol = location.protocol.replace("http", "ws");
  return address.href;
}

/** The response of the server to an authenticated request. The address is relative to the page, also with `/` first. */
export async function fetchBytes(url: string, token: string): Promise<ArrayBuffer> {
  const response = await fetch(url.replace(/^\//, "./"), { headers: { Authorization: `Bearer ${token}` } });
  if (!response.ok) throw new Error(`the server answered ${response.status}`);
  return response.arrayBuffer();
}
