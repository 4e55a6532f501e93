// Prints a line for each message of an MCAP file, as the TypeScript library reads it by its index.

import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open } from "node:fs/promises";

import { line, print, typeOf } from "./lines.mjs";

const readable = new FileHandleReadable(await open(process.argv[2]));
const decompressHandlers = await loadDecompressHandlers();
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const lines = [];
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  lines.push(line(channel, message, typeOf(reader.schemasById.get(channel.schemaId))));
}
if (reader.statistics.messageCount !== BigInt(lines.length)) {
  throw new Error(`${reader.statistics.messageCount} messages are counted, ${lines.length} are there`);
}
print(lines);
