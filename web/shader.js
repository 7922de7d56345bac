// shader: how a texel becomes a colour: of one image, or of the difference of two.

import { SIDE } from "./tiles.js";

export const TONES = ["srgb", "filmic", "false", "relative"];
/** What is drawn of a pair of tiles: the first, the signed difference of their luminances, or the absolute difference. */
export const SINGLE = 0, SIGNED = 1, ABSOLUTE = 2;
/** What the numbers of a layer are: light or the like, directions, or ids, which are red + 2048 green + 2048^2 blue. */
export const LIGHT = 0, DIRECTIONS = 1, IDS = 2;

const VERTEX = `#version 300 es
uniform vec2 viewport; uniform vec3 place; // of the image: its left and top, and its scale, in pixels of the canvas
in vec4 area; in vec2 size; in vec2 slots; // in pixels of the image: left, top, right, bottom; texels of the tile
out vec4 texel; flat out vec2 last; // the middle of the tile's last texel
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  vec2 at = place.xy + place.z * mix(area.xy, area.zw, corner);
  texel = vec4(corner * size / ${SIDE}.0, slots);
  last = (size - 0.5) / ${SIDE}.0;
  gl_Position = vec4(at / viewport * vec2(2, -2) + vec2(-1, 1), 0, 1);
}`;

// Filmic: Narkowicz (2015), "ACES Filmic Tone Mapping Curve". False colour: ten stops of luminance around middle grey, or
// the relative error (of two images: their relative difference) from 0.1 % to 100 %, on a ramp of five colours.
const FRAGMENT = `#version 300 es
precision highp float; precision highp sampler2DArray;
uniform sampler2DArray tiles; uniform float gain, offset; uniform int tone, mode, kind;
in vec4 texel; flat in vec2 last; out vec4 colour;
vec3 srgb(vec3 c) {
  return mix(12.92 * c, 1.055 * pow(max(c, vec3(0)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
vec3 filmic(vec3 c) { c = max(c, vec3(0)); return c * (2.51 * c + 0.03) / (c * (2.43 * c + 0.59) + 0.14); }
vec3 ramp(float t) {
  vec3 c[5] = vec3[5](vec3(0.05, 0.05, 0.3), vec3(0.0, 0.45, 0.75), vec3(0.1, 0.7, 0.35), vec3(0.95, 0.85, 0.2), vec3(0.85, 0.1, 0.1));
  t = clamp(t, 0.0, 1.0) * 4.0;
  int i = min(int(t), 3);
  return mix(c[i], c[i + 1], t - float(i));
}
float luminance(vec3 c) { return dot(c, vec3(0.2126, 0.7152, 0.0722)); }
vec3 toned(vec3 c, float error, float base) {
  if (tone == 3) return ramp(1.0 + log(max(error / max(base, 1e-6), 1e-6)) / log(1000.0));
  if (tone == 2) return ramp(0.5 + log2(max(luminance(c), 1e-9) / 0.18) / 10.0);
  return srgb(clamp(tone == 1 ? filmic(c) : c, 0.0, 1.0));
}
// A colour that differs from those of most other ids; 0 is no id.
vec3 idColour(vec3 id) {
  uvec3 part = uvec3(id);
  uint h = part.r + 2048u * part.g + 0x9e3779b9u * part.b;
  if (h == 0u) return vec3(0);
  h = (h ^ (h >> 16)) * 0x7feb352du;
  h = (h ^ (h >> 15)) * 0x846ca68bu;
  h ^= h >> 16;
  vec3 hue = clamp(abs(mod(6.0 * float(h & 1023u) / 1024.0 + vec3(0, 4, 2), 6.0) - 3.0) - 1.0, 0.0, 1.0);
  return mix(vec3(1), hue, 0.45 + 0.5 * float((h >> 10) & 255u) / 255.0) * (0.5 + 0.5 * float((h >> 18) & 255u) / 255.0);
}
vec3 shown(vec4 t) {
  if (kind == ${IDS}) return idColour(t.rgb);
  if (kind == ${DIRECTIONS} && tone != 3) return clamp(0.5 * t.rgb + 0.5, 0.0, 1.0);
  return toned(t.rgb * gain + offset, t.a, luminance(t.rgb));
}
void main() {
  // A pixel whose middle is on the tile's rim must not come round to its other side.
  vec2 at = clamp(texel.xy, vec2(0.5 / ${SIDE}.0), last);
  vec4 t = texture(tiles, vec3(at, texel.z));
  vec3 c;
  if (mode == ${SINGLE}) {
    c = shown(t);
  } else if (kind == ${IDS}) {
    c = vec3(any(notEqual(t.rgb, texture(tiles, vec3(at, texel.w)).rgb)));
  } else {
    vec3 other = texture(tiles, vec3(at, texel.w)).rgb;
    float d = luminance(t.rgb - other);
    if (mode == ${SIGNED}) c = srgb(clamp(gain * abs(d) * (d > 0.0 ? vec3(1.0, 0.45, 0.1) : vec3(0.1, 0.45, 1.0)), 0.0, 1.0));
    else c = toned(abs(t.rgb - other) * gain + offset, abs(d), abs(luminance(other)));
  }
  colour = vec4(c, 1);
}`;

/** Compiles and links; throws what the driver says, except when the context is lost. */
export function compile(gl) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
