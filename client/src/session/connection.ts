import { Decoder, Encoder } from "@msgpack/msgpack";
import {
  PROTOCOL,
  STATES_PER_RECEIPT,
  type ParticipantMessage,
  type WatcherMessage,
  type ServerMessage,
} from "../generated/messages";

/** `lost`: it reconnects; `refused` and `superseded`: it does not. */
export type Link = "connecting" | "connected" | "lost" | "refused" | "superseded";

export interface LinkEvents {
  message(message: ServerMessage): void;
  /** `code`: the closing code of the server, or 0. */
  link(link: Link, code: number): void;
}

/** Closing code when the page was opened elsewhere; this page must not reconnect. */
export const SUPERSEDED = 4001;
/** Closing codes after which reconnecting is useless; see `server/connection.py`. */
export const REFUSED: readonly number[] = [4400, 4401, 4403, 4410, 4411];

const FIRST_RETRY_MS = 100;
const LONGEST_RETRY_MS = 1000;
const OPENING_LIMIT_MS = 10_000;

export function retryDelayMs(failures: number): number {
  return Math.min(LONGEST_RETRY_MS, FIRST_RETRY_MS * 2 ** failures);
}

/** A WebSocket to the server that reconnects automatically. */
export class Connection {
  private socket: WebSocket | null = null;
  private welcomed = false;
  private failures = 0;
  private states = 0;

  constructor(
    private readonly url: string,
    private readonly token: string,
    private readonly emulated: boolean,
    private readonly events: LinkEvents,
  ) {}

  open(): void {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    const limit = setTimeout(() => this.closed(socket, 0), OPENING_LIMIT_MS);
    socket.onopen = () => {
      clearTimeout(limit);
      this.hello(socket);
    };
    socket.onmessage = ({ data }) => this.receive(socket, decode(data as ArrayBuffer));
    socket.onclose = ({ code }) => this.closed(socket, code);
  }

  get connected(): boolean {
    return this.welcomed && this.socket?.readyState === WebSocket.OPEN;
  }

  /** Bytes that wait to be sent. */
  get backlog(): number {
    return this.socket?.bufferedAmount ?? 0;
  }

  /** Sends a message; returns false without a connection. */
  send(message: Outgoing): boolean {
    if (!this.connected) return false;
    this.socket?.send(encode(message));
    return true;
  }

  private hello(socket: WebSocket): void {
    const device = navigator.userAgent.slice(0, 512);
    const { token, emulated } = this;
    socket.send(encode({ type: "hello", protocol: PROTOCOL, token, device, emulated }));
  }

  private receive(socket: WebSocket, message: ServerMessage): void {
    if (socket !== this.socket) return;
    if (message.type === "welcome") {
      this.welcomed = true;
      this.failures = this.states = 0;
      this.events.link("connected", 0);
    }
    if (this.welcomed || message.type === "language") this.events.message(message);
    if (message.type === "state" && ++this.states % STATES_PER_RECEIPT === 0)
      this.send({ type: "receipt", states: this.states });
  }

  private closed(socket: WebSocket, code: number): void {
    if (socket !== this.socket) return;
    this.socket = null;
    this.welcomed = false;
    socket.onopen = null;
    socket.close();
    const link = code === SUPERSEDED ? "superseded" : REFUSED.includes(code) ? "refused" : "lost";
    this.events.link(link, code);
    if (link === "lost") setTimeout(() => this.open(), retryDelayMs(this.failures++));
  }
}

export type Outgoing = ParticipantMessage | WatcherMessage;

const encoder = new Encoder();
const decoder = new Decoder();

/** The bytes of a message, valid until the next call; the recipient must copy them. */
export function encode(message: Outgoing): Uint8Array<ArrayBuffer> {
  return encoder.encodeSharedRef(message);
}

export function decode(data: ArrayBuffer): ServerMessage {
  return decoder.decode(data) as ServerMessage;
}
