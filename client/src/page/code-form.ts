import { element } from "./dom";
import type { Key, Texts } from "./texts";

const TOO_MANY = 429;

/** The form for session codes. A valid code opens the session's link on this page. */
export function setUpCodeForm(texts: () => Texts): void {
  const form = element<HTMLFormElement>("entrance");
  const input = element<HTMLInputElement>("code");
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void open(input.value).then((wrong) => {
      element("code-wrong").hidden = wrong === null;
      element("code-wrong").textContent = wrong && texts().get(wrong);
      input.select();
    });
  });
}

/** Opens the session of a code, or returns the reason for an error. */
async function open(code: string): Promise<Key | null> {
  try {
    const answer = await fetch("./link", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ code }),
    });
    if (!answer.ok) return answer.status === TOO_MANY ? "too_many_codes" : "wrong_code";
    const { token } = (await answer.json()) as { token: string };
    location.hash = `token=${token}`;
    return null;
  } catch {
    return "lost";
  }
}
