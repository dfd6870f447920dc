//! The file: topics, their schemas, and messages in the order of time.

use std::collections::BTreeMap;
use std::io::Write;
use std::marker::PhantomData;

use foxglove::{Encode, Schema};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions};
use serde::Serialize;

/// A topic of messages of one kind.
pub(super) struct Topic<T> {
    channel_id: u16,
    sequence: u32,
    of: PhantomData<fn(&T)>,
}

/// A message without a schema of Foxglove's, written as JSON.
pub(super) trait JsonMessage: Serialize {
    /// Its name and JSON schema.
    fn schema() -> Schema;
}

/// An MCAP file that is written from its beginning to its end.
pub(super) struct File<W: Write> {
    mcap: mcap::Writer<NoSeek<W>>,
    buffer: Vec<u8>,
}

impl<W: Write> File<W> {
    /// Chunks are compressed on this thread: several would make other bytes.
    pub(super) fn begin(out: W) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .library(concat!("furrow ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true);
        Ok(Self { mcap: options.create(NoSeek::new(out))?, buffer: Vec::new() })
    }

    pub(super) fn topic<T: Encode>(&mut self, name: &str) -> Result<Topic<T>, McapError> {
        let schema = T::get_schema().expect("Foxglove's messages have schemas");
        self.open(name, &schema, &T::get_message_encoding())
    }

    pub(super) fn json_topic<T: JsonMessage>(&mut self, name: &str) -> Result<Topic<T>, McapError> {
        self.open(name, &T::schema(), "json")
    }

    fn open<T>(&mut self, name: &str, schema: &Schema, encoding: &str) -> Result<Topic<T>, McapError> {
        let schema_id = self.mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?;
        let channel_id = self.mcap.add_channel(schema_id, name, encoding, &BTreeMap::new())?;
        Ok(Topic { channel_id, sequence: 0, of: PhantomData })
    }

    pub(super) fn write<T: Encode>(
        &mut self,
        topic: &mut Topic<T>,
        time_ns: u64,
        message: &T,
    ) -> Result<(), McapError> {
        self.buffer.clear();
        message.encode(&mut self.buffer).expect("a vector grows as needed");
        self.append(topic, time_ns)
    }

    pub(super) fn write_json<T: JsonMessage>(
        &mut self,
        topic: &mut Topic<T>,
        time_ns: u64,
        message: &T,
    ) -> Result<(), McapError> {
        self.buffer.clear();
        serde_json::to_writer(&mut self.buffer, message).expect("names and finite numbers are JSON");
        self.append(topic, time_ns)
    }

    fn append<T>(&mut self, topic: &mut Topic<T>, time_ns: u64) -> Result<(), McapError> {
        let (channel_id, sequence) = (topic.channel_id, topic.sequence);
        topic.sequence += 1;
        let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.mcap.write_to_known_channel(&header, &self.buffer)
    }

    pub(super) fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), McapError> {
        self.mcap.write_metadata(&Metadata { name: name.to_owned(), metadata })
    }

    pub(super) fn end(mut self) -> Result<(), McapError> {
        self.mcap.finish()?;
        Ok(self.mcap.into_inner().into_inner().flush()?)
    }
}
