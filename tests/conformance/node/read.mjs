// Prints a line for each message of an MCAP file, as the TypeScript library reads it by its index.

import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open } from "node:fs/promises";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

const types = new Map();

function typeOf(schema) {
  if (!types.has(schema.id)) {
    const files = descriptor.FileDescriptorSet.decode(schema.data);
    types.set(schema.id, protobuf.Root.fromDescriptor(files).lookupType(schema.name));
  }
  return types.get(schema.id);
}

function text(field, value) {
  if (field.type === "bytes" || field.type === "string") return Buffer.from(value).toString("hex");
  if (field.resolvedType) return field.resolvedType.valuesById[value];
  return String(value).toLowerCase();
}

function line(channel, message, type) {
  const decoded = type.decode(message.data);
  const told = type.fieldsArray.filter(
    (field) => Object.hasOwn(decoded, field.name) && (!field.repeated || decoded[field.name].length),
  );
  const fields = told.map((field) => {
    const value = decoded[field.name];
    const words = field.repeated ? value.map((one) => text(field, one)) : [text(field, value)];
    return `${field.name}=${words.join(",")}`;
  });
  const times = `${message.logTime}|${message.publishTime}`;
  return `${channel.topic}|${times}|${fields.sort().join("|")}`;
}

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
lines.sort((one, other) => Buffer.compare(Buffer.from(one), Buffer.from(other)));
process.stdout.write(lines.map((each) => `${each}\n`).join(""));
