// Programs of the graphics card, in GLSL ES 3.

/** What a point needs to know of its instance is in a table of this width, by id. */
export const TABLE_WIDTH = 1024;
/** Bits of the table's alpha. */
export const HIDDEN = 1;
export const SELECTED = 2;

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
`;

export const POINTS = `${HEAD}
layout(location = 0) in vec3 position;
layout(location = 1) in vec4 colour;
layout(location = 2) in uint instance;
layout(location = 3) in float radius;
layout(location = 4) in uint photo;
layout(location = 5) in vec3 direction;
uniform mat4 view, projection, motion;
uniform uint moved;
uniform float motionScale, pixels, grown, cut, behind;
uniform vec3 eye;
uniform vec4 height;
uniform int mode;
uniform vec3 accent;
uniform usampler2D table;
flat out vec3 shade;
flat out uint id;
flat out float depth;

vec3 hue(float h) {
  return clamp(abs(fract(h + vec3(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0);
}
// From dark violet over teal to yellow, evenly in lightness.
vec3 ramp(float t) {
  return mix(mix(vec3(0.27, 0.05, 0.42), vec3(0.13, 0.56, 0.55), smoothstep(0.0, 0.55, t)),
    vec3(0.99, 0.90, 0.22), smoothstep(0.45, 1.0, t));
}

void main() {
  uvec4 known = texelFetch(table, ivec2(instance % ${TABLE_WIDTH}u, instance / ${TABLE_WIDTH}u), 0);
  bool carried = instance == moved && moved != 0u;
  vec4 world = vec4(position, 1.0);
  vec3 seenFrom = direction;
  if (carried) {
    world = motion * world;
    seenFrom = mat3(motion) * direction;
  }
  vec4 seen = view * world;
  gl_Position = projection * seen;
  if ((known.a & ${HIDDEN}u) != 0u || dot(height, world) > cut
      || dot(normalize(seenFrom), normalize(eye - world.xyz)) < behind) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = clamp(2.0 * radius * (carried ? motionScale : 1.0) * pixels * grown / max(seen.z, 1e-6),
    1.5, 40.0);
  float grey = dot(colour.rgb, vec3(0.3, 0.59, 0.11));
  shade = colour.rgb;
  if (mode == 1) shade = instance == 0u ? vec3(0.25 + 0.3 * grey)
    : mix(vec3(known.rgb) / 255.0, vec3(known.rgb) / 255.0 * (0.45 + grey), 0.6);
  if (mode == 2) shade = ramp(colour.a);
  if (mode == 3) shade = mix(vec3(grey), hue(float(photo) * 0.381966), 0.65);
  if ((known.a & ${SELECTED}u) != 0u) shade = mix(shade, accent, 0.45);
  id = instance;
  depth = seen.z;
}`;

const ROUND = `
  vec2 off = gl_PointCoord * 2.0 - 1.0;
  if (dot(off, off) > 1.0) discard;`;

export const POINT_COLOUR = `${HEAD}
flat in vec3 shade;
out vec4 colour;
void main() {${ROUND}
  colour = vec4(shade, 1.0);
}`;

export const POINT_ID = `${HEAD}
flat in uint id;
flat in float depth;
out uvec4 answer;
void main() {${ROUND}
  answer = uvec4(id, floatBitsToUint(depth), 1u, 0u);
}`;

export const LINES = `${HEAD}
layout(location = 0) in vec3 position;
uniform mat4 view, projection;
void main() { gl_Position = projection * view * vec4(position, 1.0); }`;

export const LINE_COLOUR = `${HEAD}
uniform vec4 paint;
out vec4 colour;
void main() { colour = paint; }`;

export const PICTURE = `${HEAD}
layout(location = 0) in vec3 position;
layout(location = 1) in vec2 place;
uniform mat4 view, projection;
out vec2 at;
void main() { at = place; gl_Position = projection * view * vec4(position, 1.0); }`;

export const PICTURE_COLOUR = `${HEAD}
in vec2 at;
uniform sampler2D picture;
out vec4 colour;
void main() { colour = vec4(texture(picture, at).rgb, 1.0); }`;

export const SCREEN = `${HEAD}
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
  gl_Position = vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}`;

// Eye-dome lighting (Boucheny 2009): what lies behind its neighbours is darker, so that edges show.
export const LIGHTING = `${HEAD}
uniform sampler2D picture, depths;
uniform vec2 range;
uniform float strength, tolerance, reach;
uniform vec3 paper;
out vec4 colour;
float away(ivec2 at) {
  float d = texelFetch(depths, clamp(at, ivec2(0), textureSize(depths, 0) - 1), 0).r;
  if (d >= 1.0) return -1.0;
  float near = range.x, far = range.y;
  return log2(2.0 * far * near / (far + near - (2.0 * d - 1.0) * (far - near)));
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 own = texelFetch(picture, at, 0);
  float here = away(at);
  if (here == -1.0) { colour = vec4(paper, 1.0); return; }
  float behind = 0.0;
  int step = int(reach);
  for (int k = 0; k < 4; k++) {
    ivec2 to = k < 2 ? ivec2((k * 2 - 1) * step, 0) : ivec2(0, (k * 2 - 5) * step);
    float there = away(at + to);
    if (there != -1.0) behind += clamp(here - there - tolerance, 0.0, 0.4);
  }
  colour = vec4(own.rgb * exp(-min(behind, 1.0) * strength), 1.0);
}`;
