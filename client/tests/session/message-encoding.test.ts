import { describe, expect, it } from "vitest";
import { decode, encode } from "../../src/session/connection";
import type { ParticipantMessage } from "../../src/generated/messages";
import examples from "../data/messages.json";

function bytesOf(base64: string): Uint8Array {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

function plain(message: object): object {
  return Object.fromEntries(
    Object.entries(message).map(([key, value]) => [
      key,
      value instanceof Uint8Array ? btoa(String.fromCharCode(...value)) : value,
    ]),
  );
}

describe("messages as Python writes them", () => {
  for (const { union, value, bytes } of examples) {
    it(`${value.type} is read`, () => {
      expect(plain(decode(bytesOf(bytes).buffer as ArrayBuffer))).toEqual(value);
    });
    if (union === "ParticipantMessage") {
      it(`${value.type} is written with the same bytes`, () => {
        expect(encode(value as unknown as ParticipantMessage)).toEqual(bytesOf(bytes));
      });
    }
  }
});
