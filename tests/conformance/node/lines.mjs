// A line for each message, with its fields by the schema that came with it.

import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

const types = new Map();

export function typeOf(schema) {
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

export function line(channel, message, type) {
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

export function print(lines) {
  lines.sort((one, other) => Buffer.compare(Buffer.from(one), Buffer.from(other)));
  process.stdout.write(lines.map((each) => `${each}\n`).join(""));
}
