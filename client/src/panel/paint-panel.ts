import { layoutBodyButtons, type BodyButton } from "./body-choice";
import type { PanelContent } from "../session/display-state";
import type { ParticipantBody, CommandLabel, Contrast, Question } from "../generated/messages";
import {
  isLine,
  labelOf,
  layoutButtons,
  layoutLine,
  layoutWords,
  mirrored,
  saysItsEnds,
  type Box,
  type Button,
} from "./questionnaire";
import type { Key, Texts } from "../page/texts";
import { segmentLabel, segmentsOf, type Segment } from "./segments";

/** Values of buttons that are no answers: previous question, confirm, calibrate again, go on, break, preferences. */
export const BACK = -1;
export const DONE = -2;
export const AGAIN = -3;
export const GO_ON = -4;
export const REST = -5;
export const PREFER = -6;
const ACTION_TEXTS: Readonly<Record<number, Key>> = {
  [BACK]: "back",
  [DONE]: "done",
  [AGAIN]: "again",
  [GO_ON]: "go_on",
  [REST]: "rest",
  [PREFER]: "prefer",
};

/** Pixels of the panel's canvas. */
export const WIDTH = 1536;
export const HEIGHT = 960;

const MARGIN = 76;
/** Font sizes in pixels; `docs/reference/tracking.md` lists the visual angles. */
const LABEL = 64;
const NOTICE = 52;
const STATEMENT = 72;
const INSTRUCTION = 84;
/** Minimum font size in pixels. */
const SMALLEST = 24;
const FONT = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif";
const TEXT_BOX: Box = { x: MARGIN, y: 150, width: WIDTH - 2 * MARGIN, height: 620 };
const STATEMENT_BOX: Box = { x: MARGIN, y: 140, width: WIDTH - 2 * MARGIN, height: 300 };
const BUTTON_BOX: Box = { x: MARGIN, y: 470, width: WIDTH - 2 * MARGIN, height: 250 };
const WORDS_BOX: Box = { x: MARGIN, y: 130, width: WIDTH - 2 * MARGIN, height: 290 };
const LINE_BOX: Box = { ...BUTTON_BOX, y: 520, height: 130 };
const ANCHORS_HEIGHT = 170;
const PANEL_BOX: Box = { x: 0, y: 0, width: WIDTH, height: HEIGHT };
const BACK_BOX: Box = { x: 48, y: 36, width: 320, height: 100 };
const CONFIRM_BOX: Box = { x: MARGIN + 150, y: 560, width: WIDTH - 2 * MARGIN - 300, height: 140 };
const BODY_BOX: Box = { x: MARGIN + 150, y: 420, width: WIDTH - 2 * MARGIN - 300, height: 270 };
const GO_ON_BOX: Box = { x: WIDTH / 2 - 260, y: 710, width: 520, height: 120 };
const REST_BOX: Box = { ...GO_ON_BOX, x: 1080, width: WIDTH - MARGIN - 1080 };
const PREFER_BOX: Box = { ...REST_BOX, x: MARGIN };
/** Maximum height of a button with text, and the share of it that the text may fill. */
const WORDS_HEIGHT = 150;
const WORDS_SHARE = 0.92;
/** Minimum distance between the ticks of a line. */
const TICKS_APART = 30;
/** Possible heights of a notice; the first that fits is used. */
const NOTICE_HEIGHTS = [128, 190, 250, 310];
const NOTICE_PADDING = 30;

interface Palette {
  background: string;
  edge: string;
  text: string;
  quiet: string;
  button: string;
  hovered: string;
  answered: string;
  onLight: string;
}

const NORMAL: Palette = {
  background: "#0f2a31",
  edge: "#4f7f89",
  text: "#f5f8f7",
  quiet: "#a9c9cf",
  button: "#1d4853",
  hovered: "#bfe9f0",
  answered: "#ffd36b",
  onLight: "#0f2a31",
};
/** White, yellow and cyan on black: the contrast ratio of each text is at least 13:1. */
const HIGH: Palette = {
  background: "#000000",
  edge: "#ffffff",
  text: "#ffffff",
  quiet: "#ffffff",
  button: "#000000",
  hovered: "#ffe600",
  answered: "#00e5ff",
  onLight: "#000000",
};
const PALETTES: Readonly<Record<Contrast, Palette>> = { normal: NORMAL, high: HIGH };
/** The palette of the present call of `paint`. */
let palette = NORMAL;

type Context = CanvasRenderingContext2D;
type Asking = PanelContent & { question: Question };
type Choosing = PanelContent & { body: ParticipantBody };

/** All buttons in the order of a scan. */
export function buttonsOf(content: PanelContent | null): Button[] {
  if (!content) return [];
  const { question, confirms, again, goesOn, rests, prefers } = content;
  if (question) return inDirection(questionButtons(content, question), content);
  if (confirms || again) return inDirection(actionButtons(content), content);
  const possible = [
    { ...GO_ON_BOX, value: GO_ON, shown: goesOn },
    { ...REST_BOX, value: REST, shown: rests },
    { ...PREFER_BOX, value: PREFER, shown: prefers },
  ];
  const actions = possible.filter(({ shown }) => shown).map(({ shown: _, ...button }) => button);
  return [...bodiesOf(content), ...inDirection(actions, content)];
}

function inDirection(buttons: Button[], { texts }: PanelContent): Button[] {
  return isRightToLeft(texts) ? mirrored(buttons, PANEL_BOX) : buttons;
}

/** The label of a button. */
export function buttonLabel(content: PanelContent, value: number): string {
  const { question, texts } = content;
  if (value in ACTION_TEXTS) return texts.get(ACTION_TEXTS[value]!);
  if (!question) return bodiesOf(content).find((body) => body.value === value)?.name ?? "";
  const segment = segmentsOf(question).find((each) => each.value === value);
  return segment ? segmentLabel(question, segment) : labelOf(question, value);
}

function questionButtons({ staged, segment }: PanelContent, question: Question): Button[] {
  const back = question.number > 1 || segment ? [{ ...BACK_BOX, value: BACK }] : [];
  return [...scaleButtons(question, staged, segment), ...back];
}

function scaleButtons(question: Question, staged: boolean, segment: Segment | null): Button[] {
  const { points, labels } = question;
  if (segment) {
    const places = layoutButtons(segment.last - segment.first + 1, BUTTON_BOX);
    return places.map((place) => ({ ...place, value: place.value + segment.first - 1 }));
  }
  const segments = staged ? segmentsOf(question) : [];
  if (segments.length > 0)
    return layoutWords(segments.length, BUTTON_BOX, WORDS_HEIGHT).map((place, at) => ({ ...place, value: segments[at]!.value }));
  if (isLine(question)) return layoutLine(points, LINE_BOX);
  return labels.length > 0 ? layoutWords(points, BUTTON_BOX, WORDS_HEIGHT) : layoutButtons(points, BUTTON_BOX);
}

/** Actions side by side: change or confirm answers; calibrate again, change preferences or go on. */
function actionButtons({ confirms, prefers }: PanelContent): Button[] {
  const actions = confirms ? [BACK, DONE] : [AGAIN, ...(prefers ? [PREFER] : []), GO_ON];
  const area = actions.length > 2 ? { ...CONFIRM_BOX, x: MARGIN, width: WIDTH - 2 * MARGIN } : CONFIRM_BOX;
  const places = layoutWords(actions.length, area, area.height);
  return places.map((place, index) => ({ ...place, value: actions[index]! }));
}

function isRightToLeft({ direction }: Texts): boolean {
  return direction === "rtl";
}

export function bodiesOf(content: PanelContent | null): BodyButton[] {
  return content?.body && !content.question ? layoutBodyButtons(content.body, BODY_BOX, content.texts) : [];
}

/** Paints the whole panel on a transparent background. */
export function paint(
  context: Context,
  content: PanelContent,
  buttons: Button[],
  hovered: number | null,
  contrast: Contrast = "normal",
): void {
  palette = PALETTES[contrast];
  context.clearRect(0, 0, WIDTH, HEIGHT);
  if (content.text) paintBackground(context);
  context.direction = isRightToLeft(content.texts) ? "rtl" : "ltr";
  if (asks(content)) paintQuestion(context, content, buttons, hovered);
  else if (content.confirms || content.again) paintChoice(context, content, buttons, hovered);
  else {
    if (letsChoose(content)) paintBodies(context, content, hovered);
    else if (content.text) paintText(context, content);
    paintActions(context, content.texts, buttons, hovered);
  }
  if (content.notice) paintNotice(context, content.notice, buttons);
}

const SYMBOLS: Readonly<Record<CommandLabel["name"], string>> = {
  ...{ ready: "✓", wait: "II", slower: "−", faster: "+", closer: "↓", farther: "↑" },
  ...{ other_side: "⇄", again: "↻", stop: "■" },
};

/** Paints the icon of a robot command on a square canvas: symbol, label, and a ring that is full at `progress` 1. */
export function paintCommand(
  context: Context,
  { name, label }: CommandLabel,
  contrast: Contrast,
  highlighted: boolean,
  progress: number,
  pixels: number,
): void {
  palette = PALETTES[contrast];
  const [middle, radius, ring] = [pixels / 2, pixels * 0.4, pixels * 0.09];
  context.clearRect(0, 0, pixels, pixels);
  context.beginPath();
  context.arc(middle, middle, radius, 0, 2 * Math.PI);
  context.fillStyle = highlighted ? palette.hovered : palette.button;
  context.fill();
  context.lineWidth = ring / 3;
  context.strokeStyle = palette.edge;
  context.stroke();
  if (progress > 0) {
    context.beginPath();
    context.arc(middle, middle, radius + ring / 2, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * progress);
    context.lineWidth = ring;
    context.strokeStyle = palette.answered;
    context.stroke();
  }
  const ink = highlighted ? palette.onLight : palette.text;
  paintLine(context, SYMBOLS[name], middle, pixels * 0.38, `600 ${Math.round(pixels * 0.28)}px ${FONT}`, ink, "center");
  const words = { x: pixels * 0.16, y: pixels * 0.54, width: pixels * 0.68, height: pixels * 0.24 };
  paintLines(context, label, words, Math.round(pixels * 0.17), ink, 600);
}

/** Paints a caption, centred on a dark plate, on a canvas of this size. */
export function paintCaption(context: Context, text: string, contrast: Contrast, width: number, height: number): void {
  palette = PALETTES[contrast];
  context.clearRect(0, 0, width, height);
  roundedBox(context, { x: 4, y: 4, width: width - 8, height: height - 8 }, 40);
  context.fillStyle = palette.background;
  context.fill();
  paintLines(context, text, padded({ x: 0, y: 16, width, height: height - 32 }), STATEMENT);
}

function asks(content: PanelContent): content is Asking {
  return content.question !== null;
}

function letsChoose(content: PanelContent): content is Choosing {
  return content.body !== null;
}

function paintBackground(context: Context): void {
  roundedBox(context, { x: 4, y: 4, width: WIDTH - 8, height: HEIGHT - 8 }, 56);
  context.fillStyle = palette.background;
  context.fill();
  context.lineWidth = 4;
  context.strokeStyle = palette.edge;
  context.stroke();
}

function paintText(context: Context, { label, text, secondsLeft, goesOn }: PanelContent): void {
  paintLabel(context, label);
  const counting = secondsLeft !== null;
  const bottom = (goesOn ? GO_ON_BOX.y : TEXT_BOX.y + TEXT_BOX.height) - (counting ? 240 : 0);
  paintLines(context, text, { ...TEXT_BOX, height: bottom - TEXT_BOX.y - 20 * Number(goesOn) }, INSTRUCTION);
  if (counting)
    paintLine(context, String(secondsLeft), WIDTH / 2, bottom + 120, `600 220px ${FONT}`, palette.hovered, "center");
}

function paintQuestion(context: Context, content: Asking, buttons: Button[], hovered: number | null): void {
  const { question, texts } = content;
  const answered = content.answered ?? question.previous_answer;
  const scale = buttons.filter(({ value }) => !(value in ACTION_TEXTS));
  const drawsLine = isLine(question) && !content.staged;
  paintLabel(context, content.label);
  paintLines(context, content.text, STATEMENT_BOX, STATEMENT);
  paintActions(context, texts, buttons, hovered);
  if (drawsLine) paintLineOf(context, scale, hovered, answered);
  else {
    const size = labelSize(context, content, scale);
    for (const button of scale) {
      const colours = buttonColours(button.value, hovered, answered);
      paintButton(context, button, buttonLabel(content, button.value), size, colours);
    }
  }
  if ((!saysItsEnds(question) || isLine(question)) && !content.segment) paintAnchors(context, question, scale, isRightToLeft(texts));
}

function paintChoice(context: Context, content: PanelContent, buttons: Button[], hovered: number | null): void {
  paintLabel(context, content.confirms ? content.texts.get("answers_given") : content.label);
  paintLines(context, content.text, WORDS_BOX, STATEMENT);
  paintActions(context, content.texts, buttons, hovered);
}

/** Paints the buttons that are no answers. */
function paintActions(context: Context, texts: Texts, buttons: Button[], hovered: number | null): void {
  for (const button of buttons.filter(({ value }) => value in ACTION_TEXTS)) {
    const label = texts.get(ACTION_TEXTS[button.value]!);
    const size = fittingSize(context, label, inside(button), LABEL, 600);
    paintButton(context, button, label, size, buttonColours(button.value, hovered, null));
  }
}

/** A scale of many points: a bar with ticks, and a mark at the hovered or previous answer. */
function paintLineOf(context: Context, places: Button[], hovered: number | null, answered: number | null): void {
  const left = Math.min(...places.map(({ x }) => x));
  const { y, height, width } = places[0]!;
  roundedBox(context, { x: left, y, width: width * places.length, height }, 24);
  context.fillStyle = palette.button;
  context.fill();
  context.lineWidth = 4;
  context.strokeStyle = context.fillStyle = palette.edge;
  context.stroke();
  if (width > TICKS_APART)
    for (const { x } of places) context.fillRect(x + width / 2 - 2, y + height / 4, 4, height / 2);
  for (const [value, colour] of [[hovered, palette.hovered], [answered, palette.answered]] as const) {
    const place = places.find((each) => each.value === value);
    if (!place) continue;
    context.fillStyle = colour;
    context.fillRect(place.x + place.width / 2 - 8, y - 14, 16, height + 28);
  }
}

/** The font size at which the texts of all buttons fit. */
function labelSize(context: Context, content: PanelContent, buttons: Button[]): number {
  const sizes = buttons.map((button) =>
    fittingSize(context, buttonLabel(content, button.value), inside(button), Math.round(button.height * 0.5), 600),
  );
  return Math.min(...sizes);
}

/** The area of a button for its text. */
function inside({ x, y, width, height }: Box): Box {
  const margin = (1 - WORDS_SHARE) / 2;
  return {
    x: x + width * margin,
    y: y + height * margin,
    width: width * WORDS_SHARE,
    height: height * WORDS_SHARE,
  };
}

function paintBodies(context: Context, content: Choosing, hovered: number | null): void {
  paintLabel(context, content.label);
  paintLines(context, content.text, WORDS_BOX, STATEMENT);
  for (const button of bodiesOf(content)) paintBody(context, button, button.value === hovered);
}

function paintBody(context: Context, button: BodyButton, hovered: boolean): void {
  const [fill, ink] = hovered ? [palette.hovered, palette.onLight] : [palette.button, palette.text];
  roundedBox(context, button, button.height * 0.16);
  context.fillStyle = button.colour ?? fill;
  context.fill();
  context.lineWidth = button.chosen ? 14 : hovered ? 8 : 4;
  context.strokeStyle = button.chosen ? palette.answered : hovered ? palette.hovered : palette.edge;
  context.stroke();
  const [x, y] = [button.x + button.width / 2, button.y + button.height / 2];
  paintLine(context, button.label, x, y, `600 ${Math.round(button.height * 0.4)}px ${FONT}`, ink, "center");
}

/** Paints the meaning of both ends below them. */
function paintAnchors(context: Context, { low, high }: Question, buttons: Button[], fromRight: boolean): void {
  const left = Math.min(...buttons.map(({ x }) => x));
  const right = Math.max(...buttons.map(({ x, width }) => x + width));
  const y = Math.max(...buttons.map(({ y, height }) => y + height)) + 56;
  const half = { x: left, y, width: (right - left) / 2 - 20, height: ANCHORS_HEIGHT };
  const [atLeft, atRight] = fromRight ? [high, low] : [low, high];
  for (const [text, x, align] of [[atLeft, left, "left"], [atRight, right, "right"]] as const) {
    const size = fittingSize(context, text, half, LABEL, 400);
    const font = `${size}px ${FONT}`;
    context.font = font;
    const lines = wrap(text, half.width, (line) => context.measureText(line).width);
    lines.forEach((line, at) => paintLine(context, line, x, y + at * size * 1.3, font, palette.quiet, align));
  }
}

function buttonColours(value: number, hovered: number | null, answered: number | null): [string, string] {
  if (value === answered) return [palette.answered, palette.onLight];
  if (value === hovered && answered === null) return [palette.hovered, palette.onLight];
  return [palette.button, palette.text];
}

function paintButton(
  context: Context,
  button: Button,
  label: string,
  size: number,
  [fill, ink]: [string, string],
): void {
  roundedBox(context, button, button.height * 0.16);
  context.fillStyle = fill;
  context.fill();
  context.lineWidth = 4;
  context.strokeStyle = palette.edge;
  context.stroke();
  paintLines(context, label, inside(button), size, ink, 600);
}

function paintLabel(context: Context, label: string): void {
  paintLine(context, label, WIDTH / 2, 86, `${LABEL}px ${FONT}`, palette.quiet, "center");
}

/** Paints a notice in the tallest band of the panel without buttons. */
function paintNotice(context: Context, notice: string, buttons: Box[]): void {
  const ends = [0, ...buttons.map(({ y, height }) => y + height)];
  const bands = ends.map((top) => [top, Math.min(HEIGHT, ...buttons.map(({ y }) => y).filter((y) => y >= top))] as const);
  const free = bands.filter(([top, bottom]) => !buttons.some(({ y, height }) => y < bottom && y + height > top));
  const [top, bottom] = free.reduce((best, band) => (band[1] - band[0] > best[1] - best[0] ? band : best), [0, 0] as const);
  const heights = NOTICE_HEIGHTS.filter((height, at) => at === 0 || height + 48 <= bottom - top);
  const boxes = heights.map((height) => ({ x: 24, y: bottom - 24 - height, width: WIDTH - 48, height }));
  const fits = (box: Box) => fittingSize(context, notice, padded(box), NOTICE, 600) === NOTICE;
  const box = boxes.find(fits) ?? boxes.at(-1)!;
  roundedBox(context, box, 36);
  context.fillStyle = palette.answered;
  context.fill();
  paintLines(context, notice, padded(box), NOTICE, palette.onLight, 600);
}

function padded({ x, width, ...rest }: Box): Box {
  return { ...rest, x: x + NOTICE_PADDING, width: width - 2 * NOTICE_PADDING };
}

function roundedBox(context: Context, { x, y, width, height }: Box, radius: number): void {
  context.beginPath();
  context.roundRect(x, y, width, height, radius);
}

function paintLine(
  context: Context,
  text: string,
  x: number,
  y: number,
  font: string,
  colour: string,
  align: CanvasTextAlign,
): void {
  context.font = font;
  context.fillStyle = colour;
  context.textAlign = align;
  context.textBaseline = "middle";
  context.fillText(text, x, y);
}

/** Paints wrapped text centred in a box, with the largest font size that fits, at most `size`. */
function paintLines(
  context: Context,
  text: string,
  box: Box,
  size: number,
  colour = palette.text,
  weight = 400,
): void {
  const fitting = fittingSize(context, text, box, size, weight);
  const font = `${weight} ${fitting}px ${FONT}`;
  context.font = font;
  const lines = wrap(text, box.width, (line) => context.measureText(line).width);
  const pitch = fitting * 1.3;
  const first = box.y + box.height / 2 - ((lines.length - 1) * pitch) / 2;
  lines.forEach((line, at) =>
    paintLine(context, line, box.x + box.width / 2, first + at * pitch, font, colour, "center"),
  );
}

function fittingSize(context: Context, text: string, box: Box, size: number, weight: number): number {
  const measure = (line: string): number => context.measureText(line).width;
  for (let smaller = size; smaller > SMALLEST; smaller -= 4) {
    context.font = `${weight} ${smaller}px ${FONT}`;
    const lines = wrap(text, box.width, measure);
    if (lines.length * smaller * 1.3 <= box.height && lines.every((line) => measure(line) <= box.width))
      return smaller;
  }
  return Math.min(size, SMALLEST);
}

/** Breaks text at its line ends and between words so that no line is wider than `width`. */
export function wrap(text: string, width: number, measure: (line: string) => number): string[] {
  return text.split("\n").flatMap((paragraph) => {
    const lines: string[] = [];
    let line = "";
    for (const word of paragraph.split(" ")) {
      const longer = line ? `${line} ${word}` : word;
      if (line && measure(longer) > width) lines.push(line);
      line = line && measure(longer) > width ? word : longer;
    }
    return [...lines, line];
  });
}
