// Rewrite a recording with @mcap/core: node rewrite_recording.mjs IN OUT BLOCK_MIB none|lz4|zstd SUMMARY(0|1)
import { execFileSync } from "child_process";
import fs from "fs";
import { McapStreamReader, McapWriter } from "@mcap/core";
import lz4 from "lz4js";
import { ZstdCodec } from "zstd-codec";

const [input, output, blockMiB, compression, summary] = process.argv.slice(2);
const zstd = await new Promise((resolve) => ZstdCodec.run((codec) => resolve(new codec.Simple())));
const decompressHandlers = {
  zstd: (data) => zstd.decompress(data),
  lz4: (data, size) => new Uint8Array(lz4.decompress(data, Number(size))),
};
// by the program of Debian: zstd-codec runs out of memory at 64 MiB
const byZstd = (input) => new Uint8Array(execFileSync("zstd", ["-q", "-c"], { input, maxBuffer: 2 ** 30 }));
const compressors = { zstd: byZstd, lz4: (data) => new Uint8Array(lz4.compress(data)) };
const file = fs.openSync(output, "w");
let position = 0n;
const writable = {
  position: () => position,
  async write(data) {
    fs.writeSync(file, data);
    position += BigInt(data.length);
  },
};
const options = [
  "useStatistics", "useSummaryOffsets", "useChunkIndex", "useAttachmentIndex", "useMetadataIndex", "repeatSchemas",
  "repeatChannels", "useMessageIndex",
];
const compress = compressors[compression];
const writer = new McapWriter({
  writable,
  chunkSize: Number(blockMiB) << 20,
  compressChunk: compress && ((data) => ({ compression, compressedData: compress(data) })),
  ...Object.fromEntries(options.map((name) => [name, summary === "1"])),
});
const reader = new McapStreamReader({ decompressHandlers, validateCrcs: false });
reader.append(fs.readFileSync(input));
const schemas = new Map([[0, 0]]), channels = new Map();
for (let record; (record = reader.nextRecord()); ) {
  if (record.type === "Header") {
    await writer.start({ profile: record.profile, library: record.library });
  } else if (record.type === "Schema" && !schemas.has(record.id)) {
    schemas.set(record.id, await writer.registerSchema(record));
  } else if (record.type === "Channel" && !channels.has(record.id)) {
    channels.set(record.id, await writer.registerChannel({ ...record, schemaId: schemas.get(record.schemaId) }));
  } else if (record.type === "Message") {
    await writer.addMessage({ ...record, channelId: channels.get(record.channelId) });
  } else if (record.type === "Attachment") {
    await writer.addAttachment(record);
  } else if (record.type === "Metadata") {
    await writer.addMetadata(record);
  }
}
await writer.end();
fs.closeSync(file);
