// What Foxglove's own readers (@mcap/core) find in an MCAP file, as one line of JSON.
//
// node read.mjs FILE [TOPIC]
//
// `indexed` and `backwards`: the messages that the reader with a seekable file gives, which is how Foxglove opens
// a log, in the order of their log times, and from the last to the first; of TOPIC alone if one is named. `bytes`:
// what it read of the file for `indexed`. `streamed`: the messages in the order of the file. Each is
// [topic, sequence, log time, publish time, SHA-256 of the data]. Every CRC is compared that these readers know.

import { createHash } from "node:crypto";
import { openSync, fstatSync, readSync, readFileSync } from "node:fs";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";

const [path, topic] = process.argv.slice(2);
const PIECE_BYTES = 65521; // no record ends where one of these does

class SeekableFile {
  bytes = 0;
  #file = openSync(path);

  async size() {
    return BigInt(fstatSync(this.#file).size);
  }

  async read(offset, length) {
    const data = new Uint8Array(Number(length));
    if (readSync(this.#file, data, 0, data.length, Number(offset)) !== data.length) {
      throw new Error(`${path}: no ${length} bytes at ${offset}`);
    }
    this.bytes += data.length;
    return data;
  }
}

const sha256 = (data) => createHash("sha256").update(data).digest("hex");
const told = (topic, { sequence, logTime, publishTime, data }) => [
  topic,
  sequence,
  String(logTime),
  String(publishTime),
  sha256(data),
];
const attached = ({ name, data }) => [name, sha256(data)];

async function indexed() {
  const file = new SeekableFile();
  const reader = await McapIndexedReader.Initialize({ readable: file });
  const messages = async (options) => {
    const found = [];
    for await (const message of reader.readMessages({ ...options, ...(topic && { topics: [topic] }) })) {
      found.push(told(reader.channelsById.get(message.channelId).topic, message));
    }
    return found;
  };
  const forwards = await messages({});
  const bytes = file.bytes;
  const schemas = {};
  const counts = {};
  for (const channel of reader.channelsById.values()) {
    const schema = reader.schemasById.get(channel.schemaId);
    schemas[channel.topic] = [schema.name, schema.encoding, sha256(schema.data), channel.messageEncoding];
    counts[channel.topic] = Number(reader.statistics.channelMessageCounts.get(channel.id));
  }
  const metadata = [];
  for await (const { name, metadata: values } of reader.readMetadata()) {
    metadata.push([name, Object.fromEntries(values)]);
  }
  const attachments = [];
  for await (const attachment of reader.readAttachments()) {
    attachments.push(attached(attachment));
  }
  const backwards = await messages({ reverse: true });
  return { indexed: forwards, bytes, backwards, schemas, counts, metadata, attachments };
}

function streamed() {
  const reader = new McapStreamReader({ validateCrcs: true });
  const data = readFileSync(path);
  const topics = new Map();
  const found = { streamed: [], streamed_metadata: [], streamed_attachments: [] };
  for (let at = 0; at < data.length; at += PIECE_BYTES) {
    reader.append(data.subarray(at, at + PIECE_BYTES));
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Channel") {
        topics.set(record.id, record.topic);
      } else if (record.type === "Message") {
        found.streamed.push(told(topics.get(record.channelId), record));
      } else if (record.type === "Metadata") {
        found.streamed_metadata.push([record.name, Object.fromEntries(record.metadata)]);
      } else if (record.type === "Attachment") {
        found.streamed_attachments.push(attached(record));
      }
    }
  }
  if (!reader.done()) {
    throw new Error(`${path}: not whole`);
  }
  return found;
}

console.log(JSON.stringify({ ...(await indexed()), ...(topic ? {} : streamed()) }));
