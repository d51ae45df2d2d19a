import { decode as decodeAny, encode as encodeAny } from "@msgpack/msgpack";
import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { Connection, REFUSED, SUPERSEDED, retryDelayMs, type Link } from "../../src/session/connection";
import { PROTOCOL, STATES_PER_RECEIPT, type ServerMessage } from "../../src/generated/messages";

class FakeSocket {
  static readonly OPEN = 1;
  static all: FakeSocket[] = [];
  readyState = FakeSocket.OPEN;
  binaryType = "";
  bufferedAmount = 0;
  sent: unknown[] = [];
  onopen: (() => void) | null = null;
  onmessage: ((event: { data: ArrayBuffer }) => void) | null = null;
  onclose: ((event: { code: number; reason: string }) => void) | null = null;

  constructor(readonly url: string) {
    FakeSocket.all.push(this);
  }

  send(data: Uint8Array): void {
    this.sent.push(decodeAny(data));
  }

  close(): void {}

  receive(message: object): void {
    this.onmessage?.({ data: encodeAny(message).slice().buffer });
  }

  drop(code = 1006, reason = ""): void {
    this.onclose?.({ code, reason });
  }
}

const WELCOME = { type: "welcome", protocol: PROTOCOL, session: "s" };
let links: [Link, number][] = [];
let messages: ServerMessage[] = [];

function newest(): FakeSocket {
  return FakeSocket.all[FakeSocket.all.length - 1]!;
}

function connection(): Connection {
  const made = new Connection("ws://x/ws", "secret", true, {
    message: (message) => messages.push(message),
    link: (link, code) => links.push([link, code]),
  });
  made.open();
  return made;
}

beforeEach(() => {
  vi.useFakeTimers();
  vi.stubGlobal("WebSocket", FakeSocket);
  vi.stubGlobal("navigator", { userAgent: "headset ".repeat(200) });
  FakeSocket.all = [];
  links = [];
  messages = [];
});

afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

describe("a connection", () => {
  it("says hello first, with the token and a name that is not too long", () => {
    connection();
    newest().onopen?.();
    expect(newest().sent).toEqual([
      { type: "hello", protocol: PROTOCOL, token: "secret", device: "headset ".repeat(64), emulated: true },
    ]);
  });

  it("says of each connection how many states it has brought", () => {
    connection();
    for (const drops of [true, false]) {
      newest().onopen?.();
      newest().receive(WELCOME);
      for (let count = 0; count < 2 * STATES_PER_RECEIPT + 1; count++) newest().receive({ type: "state" });
      expect(newest().sent.slice(1)).toEqual(
        [1, 2].map((times) => ({ type: "receipt", states: times * STATES_PER_RECEIPT })),
      );
      if (!drops) continue;
      newest().drop();
      vi.advanceTimersByTime(1000);
    }
    expect(FakeSocket.all.length).toBe(2);
  });

  it("sends nothing else before it is welcome", () => {
    const made = connection();
    newest().onopen?.();
    expect(made.send({ type: "ready" })).toBe(false);
    newest().receive(WELCOME);
    expect(made.send({ type: "ready" })).toBe(true);
    expect(newest().sent).toHaveLength(2);
    expect(links).toEqual([["connected", 0]]);
    expect(messages).toEqual([WELCOME]);
  });

  it("sends nothing into a socket that is closing", () => {
    const made = connection();
    newest().receive(WELCOME);
    newest().readyState = 2;
    expect(made.connected).toBe(false);
    expect(made.send({ type: "stop", method: "key" })).toBe(false);
  });

  it("comes back within two seconds, ever more slowly while the server is away", () => {
    connection();
    const waits = Array.from({ length: 8 }, () => {
      const sockets = FakeSocket.all.length;
      newest().drop();
      const start = Date.now();
      while (FakeSocket.all.length === sockets) vi.advanceTimersByTime(10);
      return Date.now() - start;
    });
    expect(waits).toEqual([...waits].sort((a, b) => a - b));
    expect(waits[0]).toBe(100);
    expect(Math.max(...waits)).toBeLessThan(2000);
  });

  it("comes back quickly again after it was welcome", () => {
    connection();
    for (let n = 0; n < 5; n++) {
      newest().drop();
      vi.advanceTimersByTime(2000);
    }
    newest().receive(WELCOME);
    newest().drop(1012, "restart");
    vi.advanceTimersByTime(retryDelayMs(0));
    expect(FakeSocket.all).toHaveLength(7);
    expect(links[links.length - 1]).toEqual(["lost", 1012]);
  });

  it("gives up an attempt that never opens", () => {
    connection();
    vi.advanceTimersByTime(12_000);
    expect(FakeSocket.all.length).toBe(2);
  });

  it("keeps one that has opened, however long the welcome takes", () => {
    connection();
    newest().onopen?.();
    vi.advanceTimersByTime(60_000);
    expect(FakeSocket.all).toHaveLength(1);
  });

  it.each(REFUSED)("stays away when the server refuses it for good with %i", (code) => {
    connection();
    newest().drop(code);
    vi.advanceTimersByTime(60_000);
    expect(FakeSocket.all).toHaveLength(1);
    expect(links).toEqual([["refused", code]]);
  });

  it("stays away when the page was opened elsewhere", () => {
    connection();
    newest().drop(SUPERSEDED);
    vi.advanceTimersByTime(60_000);
    expect(FakeSocket.all).toHaveLength(1);
    expect(links).toEqual([["superseded", SUPERSEDED]]);
  });

  it("does not listen to a socket that it has given up", () => {
    connection();
    const old = newest();
    old.drop();
    vi.advanceTimersByTime(100);
    old.receive(WELCOME);
    old.drop();
    expect(messages).toEqual([]);
    expect(FakeSocket.all).toHaveLength(2);
  });
});
