// Reads MCAP files with the reader of another house, by their index: for each, one line of JSON.
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";
import { open } from "node:fs/promises";

for (const path of process.argv.slice(2)) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      const { bytesRead } = await file.read(buffer, 0, buffer.length, Number(offset));
      if (bytesRead !== buffer.length) throw new Error(`${path}: short read`);
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({
    readable,
    decompressHandlers: { zstd: (buffer, size) => decompress(buffer, new Uint8Array(Number(size))) },
  });
  const topics = {};
  for await (const message of reader.readMessages()) {
    const { topic } = reader.channelsById.get(message.channelId);
    topics[topic] = (topics[topic] ?? 0) + 1;
  }
  const metadata = [];
  for await (const record of reader.readMetadata()) metadata.push(record.name);
  await file.close();
  console.log(JSON.stringify({ path, topics, metadata, said: Number(reader.statistics.messageCount) }));
}
