import { expect, test } from "vitest";
import { freeOf, offset } from "../../src/scene/view";

function rectangle(left: number, top: number, right: number, bottom: number) {
  return { left, top, right, bottom };
}

const AREA = rectangle(0, 0, 600, 400);

test.each([
  ["left", rectangle(0, 0, 200, 400), rectangle(200, 0, 600, 400)],
  ["below", rectangle(0, 300, 600, 400), rectangle(0, 0, 600, 300)],
  ["above", rectangle(0, 0, 600, 100), rectangle(0, 100, 600, 400)],
  ["nowhere", rectangle(0, 500, 600, 900), AREA],
])("the scene's middle lies in the middle of what a card %s leaves free", (_, card, free) => {
  expect(freeOf(AREA, card)).toEqual(free);
  const [x, y] = offset(AREA, freeOf(AREA, card));
  expect(AREA.right / 2 - x).toBe((free.left + free.right) / 2);
  expect(AREA.bottom / 2 - y).toBe((free.top + free.bottom) / 2);
});
