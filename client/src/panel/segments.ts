import type { Question } from "../generated/messages";
import { isLine, labelOf } from "./questionnaire";

/** Values of segments: −100 is the first one, −101 the second. */
const FIRST_SEGMENT = -100;

/** A part of a long scale: its first and last value. */
export interface Segment {
  value: number;
  first: number;
  last: number;
}

/**
 * The segments of a long scale, about as many as each has values; none for a short scale.
 *
 * Participants who do not point choose a segment first, then a value in it.
 */
export function segmentsOf(question: Question): Segment[] {
  if (!isLine(question)) return [];
  const { points } = question;
  const size = Math.ceil(Math.sqrt(points));
  return Array.from({ length: Math.ceil(points / size) }, (_, at) => {
    const first = at * size + 1;
    return { value: FIRST_SEGMENT - at, first, last: Math.min(points, first + size - 1) };
  });
}

export function segmentLabel(question: Question, { first, last }: Segment): string {
  return first === last ? labelOf(question, first) : `${labelOf(question, first)} – ${labelOf(question, last)}`;
}
