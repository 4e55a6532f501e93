// Prints a line for each message of a server, as the TypeScript library of its protocol receives it.
// The server hangs up at the end.

import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

import { line, print, typeOf } from "./lines.mjs";

const { FoxgloveClient } = protocol;
const socket = new WebSocket(process.argv[2], [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const channels = new Map();
const lines = [];

client.on("advertise", (advertised) => {
  for (const channel of advertised) channels.set(client.subscribe(channel.id), channel);
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const channel = channels.get(subscriptionId);
  const schema = { id: channel.id, name: channel.schemaName, data: Buffer.from(channel.schema, "base64") };
  const message = { logTime: timestamp, publishTime: timestamp, data: new Uint8Array(data.buffer, data.byteOffset, data.byteLength) };
  lines.push(line(channel, message, typeOf(schema)));
});
client.on("error", (error) => {
  throw error;
});
client.on("close", () => print(lines));
