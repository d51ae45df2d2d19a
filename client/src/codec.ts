import { Decoder, Encoder } from "@msgpack/msgpack";
import type { ClientMessage, ExperimenterMessage, ServerMessage } from "./messages";

export type Outgoing = ClientMessage | ExperimenterMessage;

const encoder = new Encoder();
const decoder = new Decoder();

/** The bytes of a message, valid until the next call: whoever sends them copies them. */
export function encode(message: Outgoing): Uint8Array<ArrayBuffer> {
  return encoder.encodeSharedRef(message);
}

export function decode(data: ArrayBuffer): ServerMessage {
  return decoder.decode(data) as ServerMessage;
}
