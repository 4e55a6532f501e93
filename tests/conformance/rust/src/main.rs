//! Prints a line for each message of an MCAP file, by its index and with every CRC checked.

use std::collections::HashMap;
use std::error::Error;
use std::fs;

use mcap::{MessageStream, Summary};
use prost_reflect::{DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MessageDescriptor, Value};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: mcap-lines FILE")?;
    let bytes = fs::read(path)?;
    let summary = Summary::read(&bytes)?.ok_or("the file has no summary")?;
    let mut lines = Vec::new();
    let mut types = HashMap::new();
    for chunk in &summary.chunk_indexes {
        for message in summary.stream_chunk(&bytes, chunk)? {
            lines.push(line(&message?, &mut types)?);
        }
    }
    let mut in_sequence = Vec::new();
    for message in MessageStream::new(&bytes)? {
        in_sequence.push(line(&message?, &mut types)?);
    }
    lines.sort();
    in_sequence.sort();
    if lines != in_sequence {
        return Err("the index leads to other messages than the file holds".into());
    }
    let counted = summary.stats.as_ref().ok_or("the file has no statistics")?.message_count;
    if counted != lines.len() as u64 {
        return Err(format!("{counted} messages are counted, {} are there", lines.len()).into());
    }
    for line in lines {
        println!("{line}");
    }
    Ok(())
}

fn line(
    message: &mcap::Message,
    types: &mut HashMap<String, MessageDescriptor>,
) -> Result<String, Box<dyn Error>> {
    let schema = message.channel.schema.as_ref().ok_or("a channel has no schema")?;
    if !types.contains_key(&schema.name) {
        let pool = DescriptorPool::decode(schema.data.as_ref())?;
        let found = pool.get_message_by_name(&schema.name).ok_or("a schema lacks its message")?;
        types.insert(schema.name.clone(), found);
    }
    let decoded = DynamicMessage::decode(types[&schema.name].clone(), message.data.as_ref())?;
    let mut fields: Vec<String> = types[&schema.name]
        .fields()
        .filter(|field| decoded.has_field(field))
        .map(|field| format!("{}={}", field.name(), text(&field, &decoded.get_field(&field))))
        .collect();
    fields.sort();
    let (topic, logged) = (&message.channel.topic, message.log_time);
    Ok(format!("{topic}|{logged}|{}|{}", message.publish_time, fields.join("|")))
}

fn text(field: &FieldDescriptor, value: &Value) -> String {
    match value {
        Value::Bool(value) => value.to_string(),
        Value::U32(value) => value.to_string(),
        Value::U64(value) => value.to_string(),
        Value::I32(value) => value.to_string(),
        Value::I64(value) => value.to_string(),
        Value::F32(value) => value.to_string().to_lowercase(),
        Value::F64(value) => value.to_string().to_lowercase(),
        Value::Bytes(value) => hex(value),
        Value::String(value) => hex(value.as_bytes()),
        Value::List(values) => {
            values.iter().map(|value| text(field, value)).collect::<Vec<_>>().join(",")
        }
        Value::EnumNumber(number) => match field.kind() {
            Kind::Enum(names) => names.get_value(*number).map_or("?".into(), |v| v.name().into()),
            _ => "?".into(),
        },
        _ => "?".into(),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
