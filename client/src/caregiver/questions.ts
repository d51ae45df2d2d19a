import { createElement } from "../page/dom";

/** A question to the caregiver; see `study/dashboard/caregiver.py`. */
export interface CaregiverItem {
  id: string;
  text: string;
  points: number;
  low: string;
  high: string;
  labels: string[];
  answer: number | null;
}

/** The fields of the questions: a group of radio buttons for each one. `chosen` is called with each answer. */
export function questionFields(items: readonly CaregiverItem[], chosen: (item: string, value: number) => void): HTMLElement[] {
  return items.map((item) => {
    const field = createElement("fieldset");
    field.append(createElement("legend", item.text), ...choices(item, chosen));
    return field;
  });
}

function choices(item: CaregiverItem, chosen: (item: string, value: number) => void): HTMLLabelElement[] {
  return Array.from({ length: item.points }, (_, index) => {
    const value = index + 1;
    const label = createElement("label");
    const radio = createElement("input");
    Object.assign(radio, { type: "radio", name: item.id, value: String(value), checked: item.answer === value });
    radio.addEventListener("change", () => chosen(item.id, value));
    label.className = "choice";
    label.append(radio, createElement("span", labelOf(item, value)));
    return label;
  });
}

/** The label of a value: its own, or its number with the meaning of the ends. */
function labelOf({ labels, points, low, high }: CaregiverItem, value: number): string {
  const own = labels[value - 1];
  if (own !== undefined) return own;
  const meaning = value === 1 ? low : value === points ? high : "";
  return meaning ? `${value}: ${meaning}` : String(value);
}
