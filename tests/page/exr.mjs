// exr: a reader of the OpenEXR files that Lightmill writes (one part, scanlines, ZIP, floats or halves), written from the
// file format's description so that the page is compared with something that shares no code with it.
import fs from "node:fs";
import zlib from "node:zlib";

function text(bytes, at) {
  const end = bytes.indexOf(0, at);
  return [bytes.toString("latin1", at, end), end + 1];
}

function readChannels(bytes) {
  const channels = [];
  for (let at = 0; bytes[at] !== 0; ) {
    let name;
    [name, at] = text(bytes, at);
    channels.push({ name, type: bytes.readInt32LE(at) });
    at += 16;
  }
  return channels;
}

function readHeader(bytes) {
  if (bytes.readUInt32LE(0) !== 20000630) throw new Error("no OpenEXR file");
  const header = {};
  let at = 8;
  while (bytes[at] !== 0) {
    let name, type;
    [name, at] = text(bytes, at);
    [type, at] = text(bytes, at);
    const size = bytes.readInt32LE(at), value = bytes.subarray(at + 4, at + 4 + size);
    at += 4 + size;
    if (name === "channels") header.channels = readChannels(value);
    if (name === "dataWindow") [header.width, header.height] = [value.readInt32LE(8) - value.readInt32LE(0) + 1, value.readInt32LE(12) - value.readInt32LE(4) + 1];
    if (name === "compression") header.compression = value[0];
  }
  if (header.compression !== 3) throw new Error(`compression ${header.compression} instead of ZIP`);
  return [header, at + 1];
}

/** Undoes ZIP's predictor and its split into even and odd bytes. */
function unzip(data, size) {
  if (data.length === size) return data;
  const mixed = zlib.inflateSync(data), bytes = Buffer.alloc(size), half = (size + 1) >> 1;
  for (let i = 1; i < size; i++) mixed[i] = (mixed[i - 1] + mixed[i] - 128) & 255;
  for (let i = 0; i < size; i++) bytes[i] = mixed[(i >> 1) + (i & 1 ? half : 0)];
  return bytes;
}

export function halfValue(bits) {
  const exponent = (bits >> 10) & 31, fraction = bits & 1023, sign = bits & 0x8000 ? -1 : 1;
  return sign * (exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25));
}

/** { width, height, channels: { "R": Float32Array, ... } }. */
export function readExr(path) {
  const bytes = fs.readFileSync(path), [header, table] = readHeader(bytes);
  const { width, height } = header, channels = {};
  for (const { name } of header.channels) channels[name] = new Float32Array(width * height);
  const line = header.channels.reduce((sum, c) => sum + width * (c.type === 1 ? 2 : 4), 0);
  for (let block = 0; block < Math.ceil(height / 16); block++) {
    let at = Number(bytes.readBigUInt64LE(table + 8 * block));
    const y0 = bytes.readInt32LE(at), lines = Math.min(16, height - y0), size = bytes.readInt32LE(at + 4);
    const data = unzip(bytes.subarray(at + 8, at + 8 + size), lines * line);
    at = 0;
    for (let y = y0; y < y0 + lines; y++)
      for (const { name, type } of header.channels)
        for (let x = 0; x < width; x++, at += type === 1 ? 2 : 4)
          channels[name][y * width + x] = type === 1 ? halfValue(data.readUInt16LE(at)) : type === 2 ? data.readFloatLE(at) : data.readUInt32LE(at);
  }
  return { width, height, channels };
}
