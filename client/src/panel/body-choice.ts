import { PHASES_WHERE, type ParticipantBody, type BodyChoice, type PhaseDescription } from "../generated/messages";
import { layoutButtons, type Box, type Button } from "./questionnaire";
import type { Key, Texts } from "../page/texts";

export const SEXES = ["woman", "man"] as const;

/** A body to choose: its name, its button's label or colour, whether it is chosen, and the message that selects it. */
interface Choice {
  name: string;
  label: string;
  colour: string | null;
  chosen: boolean;
  message: BodyChoice;
}

/** A button that chooses a body. */
export interface BodyButton extends Button, Choice {}

/** Whether the participant's body may be changed. */
export function canChooseBody(phase: PhaseDescription | null): boolean {
  return phase !== null && PHASES_WHERE.can_choose_body.includes(phase.name);
}

/** Buttons of both sexes in the upper half of an area, of all skin tones in the lower half, with consecutive values. */
export function layoutBodyButtons(body: ParticipantBody, area: Box, texts: Texts): BodyButton[] {
  const height = area.height * 0.46;
  const tones = { ...area, y: area.y + area.height - height, height };
  const rows = [row(sexChoices(body, texts), { ...area, height }, 3), row(toneChoices(body, texts), tones, 1)].flat();
  return rows.map((button, at) => ({ ...button, value: at + 1 }));
}

export function cssColour(rgb: readonly number[]): string {
  return `rgb(${rgb.map((share) => Math.round(255 * share)).join(" ")})`;
}

function sexChoices(body: ParticipantBody, texts: Texts): Choice[] {
  return SEXES.map((sex) => ({
    name: texts.get(sex),
    label: texts.get(sex),
    colour: null,
    chosen: sex === body.sex,
    message: { type: "choose_body", sex, skin_tone: body.skin_tone },
  }));
}

function toneChoices(body: ParticipantBody, texts: Texts): Choice[] {
  return body.skin_tones.map((tone, at) => ({
    name: texts.get(tone as Key),
    label: "",
    colour: cssColour(body.skin_tones_rgb[at]!),
    chosen: tone === body.skin_tone,
    message: { type: "choose_body", sex: body.sex, skin_tone: tone },
  }));
}

/** A row of buttons with this ratio of width to height. */
function row(choices: Choice[], area: Box, wide: number): BodyButton[] {
  const squares = layoutButtons(choices.length * wide, area);
  return choices.map((choice, at) => {
    const [first, last] = [squares[at * wide]!, squares[(at + 1) * wide - 1]!];
    return { ...first, ...choice, width: last.x + last.width - first.x };
  });
}
