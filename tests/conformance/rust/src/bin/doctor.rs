//! Prints what the rules of the MCAP format, and the advice of its project's own checker
//! (`mcap doctor`), find wrong with a file: one line each, nothing for a file without fault.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fs;

use mcap::read::{ChunkReader, LinearReader};
use mcap::records::{Channel, ChunkHeader, ChunkIndex, Record, Statistics};
use mcap::sans_io::{LinearReadEvent, LinearReader as Scanner, LinearReaderOptions};
use mcap::MAGIC;

const HEAD: usize = 1 + 8;

/// Name, encoding and data.
type Schema = (String, String, Vec<u8>);

#[derive(Default)]
struct Definitions {
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Channel>,
}

#[derive(Default)]
struct Doctor {
    remarks: Vec<String>,
    /// The definitions of the data section, in chunks and outside.
    data: Definitions,
    summary: Definitions,
    in_summary: bool,
    chunks: BTreeMap<u64, (ChunkHeader, usize)>,
    indexes: BTreeMap<u64, ChunkIndex>,
    statistics: Vec<Statistics>,
    counts: BTreeMap<u16, u64>,
    metadata: u32,
    span: Option<(u64, u64)>,
    last_record: u8,
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: doctor FILE")?;
    let bytes = fs::read(path)?;
    let mut doctor = Doctor::default();
    doctor.check_checksums(&bytes);
    let mut offset = MAGIC.len() as u64;
    let mut lengths = bytes.get(MAGIC.len()..).unwrap_or(&[]);
    for record in LinearReader::new(&bytes)? {
        match record {
            Ok(record) => {
                let length = HEAD + u64::from_le_bytes(lengths[1..HEAD].try_into()?) as usize;
                doctor.record(record, offset, length);
                lengths = &lengths[length..];
                offset += length as u64;
            }
            Err(error) => doctor.remark(format!("the record at byte {offset}: {error}")),
        }
    }
    doctor.check_end(lengths.len());
    doctor.check_indexes();
    doctor.check_statistics();
    for remark in doctor.remarks {
        println!("{remark}");
    }
    Ok(())
}

impl Doctor {
    fn remark(&mut self, text: String) {
        self.remarks.push(text);
    }

    /// The checksums of the chunks, the data and the summary.
    fn check_checksums(&mut self, mut bytes: &[u8]) {
        let mut scanner = Scanner::new_with_options(
            LinearReaderOptions::default()
                .with_validate_chunk_crcs(true)
                .with_validate_data_section_crc(true)
                .with_validate_summary_section_crc(true),
        );
        while let Some(event) = scanner.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let count = wanted.min(bytes.len());
                    scanner.insert(count).copy_from_slice(&bytes[..count]);
                    scanner.notify_read(count);
                    bytes = &bytes[count..];
                }
                Ok(LinearReadEvent::Record { .. }) => {}
                Err(error) => return self.remark(format!("{error}")),
            }
        }
    }

    fn record(&mut self, record: Record, offset: u64, length: usize) {
        self.last_record = record.opcode();
        match record {
            Record::Header(header) => {
                if header.library.is_empty() {
                    self.remark("the header names no library".into());
                }
                if !["", "ros1", "ros2"].contains(&header.profile.as_str()) {
                    self.remark(format!("the profile {:?} is not well known", header.profile));
                }
            }
            Record::Chunk { header, data } => self.chunk(header, &data, offset, length),
            Record::Message { .. } => self.remark("a message outside of chunks".into()),
            Record::ChunkIndex(index) => {
                if self.indexes.insert(index.chunk_start_offset, index).is_some() {
                    self.remark("a chunk has several indexes".into());
                }
            }
            Record::Statistics(statistics) => self.statistics.push(statistics),
            Record::DataEnd(_) => self.in_summary = true,
            Record::Metadata(_) => self.metadata += 1,
            Record::Unknown { opcode, .. } => self.remark(format!("a record of opcode {opcode}")),
            other => self.define(other),
        }
    }

    fn define(&mut self, record: Record) {
        let known = if self.in_summary { &mut self.summary } else { &mut self.data };
        match record {
            Record::Schema { header, data } => {
                let schema = (header.name, header.encoding, data.into_owned());
                let incomplete = header.id == 0 || schema.1.is_empty();
                let again = known.schemas.insert(header.id, schema.clone()).is_some();
                if incomplete {
                    self.remark(format!("schema {} has no number or no encoding", header.id));
                }
                if again {
                    self.remark(format!("schema {} exists twice in its section", header.id));
                }
                if self.data.schemas.get(&header.id) != Some(&schema) {
                    self.remark(format!("schema {} differs from that in the data", header.id));
                }
            }
            Record::Channel(channel) => {
                let id = channel.id;
                if known.channels.insert(id, channel.clone()).is_some() {
                    self.remark(format!("channel {id} exists twice in its section"));
                }
                if self.data.channels.get(&id) != Some(&channel) {
                    self.remark(format!("channel {id} differs from that in the data"));
                }
                if !self.data.schemas.contains_key(&channel.schema_id) {
                    self.remark(format!("channel {id} comes before its schema"));
                }
            }
            _ => {}
        }
    }

    fn chunk(&mut self, header: ChunkHeader, data: &[u8], offset: u64, length: usize) {
        let records = match ChunkReader::new(header.clone(), data) {
            Ok(records) => records,
            Err(error) => return self.remark(format!("the chunk at byte {offset}: {error}")),
        };
        let mut span = None;
        for record in records {
            match record {
                Ok(Record::Message { header, .. }) => {
                    if !self.data.channels.contains_key(&header.channel_id) {
                        self.remark(format!("a message before its channel {}", header.channel_id));
                    }
                    if self.span.is_some_and(|(_, last)| header.log_time < last) {
                        self.remark(format!("the log time {} falls", header.log_time));
                    }
                    span = including(span, header.log_time);
                    self.span = including(self.span, header.log_time);
                    *self.counts.entry(header.channel_id).or_default() += 1;
                }
                Ok(Record::Schema { .. } | Record::Channel(_)) => self.define(record.unwrap()),
                Ok(other) => self.remark(format!("opcode {} in a chunk", other.opcode())),
                Err(error) => self.remark(format!("in the chunk at byte {offset}: {error}")),
            }
        }
        if span != Some((header.message_start_time, header.message_end_time)) {
            self.remark(format!("the chunk at byte {offset} has other times than its messages"));
        }
        self.chunks.insert(offset, (header, length));
    }

    fn check_end(&mut self, rest: usize) {
        if !self.in_summary || self.last_record != mcap::records::op::FOOTER {
            self.remark("data end or footer is missing".into());
        }
        if rest > MAGIC.len() {
            self.remark(format!("{} bytes follow the end", rest - MAGIC.len()));
        }
    }

    fn check_indexes(&mut self) {
        let indexed: BTreeSet<_> = self.indexes.keys().collect();
        if indexed != self.chunks.keys().collect() {
            self.remark("the chunk indexes are not those of the chunks".into());
        }
        let mut remarks = Vec::new();
        for (offset, (header, length)) in &self.chunks {
            let Some(index) = self.indexes.get(offset) else { continue };
            let same = index.message_start_time == header.message_start_time
                && index.message_end_time == header.message_end_time
                && index.compression == header.compression
                && index.compressed_size == header.compressed_size
                && index.uncompressed_size == header.uncompressed_size
                && index.chunk_length == *length as u64;
            if !same {
                remarks.push(format!("the index of the chunk at byte {offset} differs from it"));
            }
        }
        for id in self.counts.keys() {
            if !self.summary.channels.contains_key(id) {
                remarks.push(format!("channel {id} is not in the summary"));
            }
        }
        for channel in self.summary.channels.values() {
            if !self.summary.schemas.contains_key(&channel.schema_id) {
                remarks.push(format!("schema {} is not in the summary", channel.schema_id));
            }
        }
        self.remarks.append(&mut remarks);
    }

    fn check_statistics(&mut self) {
        let [found] = self.statistics.as_slice() else {
            return self.remark(format!("{} statistics records", self.statistics.len()));
        };
        let expected = Statistics {
            message_count: self.counts.values().sum(),
            schema_count: self.data.schemas.len() as u16,
            channel_count: self.data.channels.len() as u32,
            attachment_count: 0,
            metadata_count: self.metadata,
            chunk_count: self.chunks.len() as u32,
            message_start_time: self.span.unwrap_or_default().0,
            message_end_time: self.span.unwrap_or_default().1,
            channel_message_counts: self.counts.clone(),
        };
        if found != &expected {
            self.remark(format!("the statistics are {found:?}, the file has {expected:?}"));
        }
    }
}

fn including(span: Option<(u64, u64)>, time: u64) -> Option<(u64, u64)> {
    let (first, last) = span.unwrap_or((time, time));
    Some((first.min(time), last.max(time)))
}
