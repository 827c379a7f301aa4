// What is drawn for a pixel of the view. Tone maps are those of the engine (worker/engine/src/film/tonemap.rs), term by term.

export const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(corner * 4.0 - 1.0, 0.0, 1.0);
}`;

export const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D first;
uniform sampler2D second;
uniform sampler2D colors;
uniform vec4 pane;       // left, bottom, width, height in device pixels
uniform vec2 origin;     // the picture's top left corner, from that of the pane
uniform float zoom;      // device pixels per pixel
uniform ivec2 size;      // of the picture
uniform int kind;        // 0 colour, 1 vector, 2 scalar, 3 integer, 4 as it is
uniform bool difference;
uniform bool counted;    // integers are counts, not ids
uniform bvec2 displayed; // tone mapped already
uniform int toneMap;     // 0 PBR Neutral, 1 AgX, 2 none
uniform float exposure;  // factor
uniform vec2 range;
uniform uint low;        // of a range of integers, exact where floats are not
uniform float span;      // of the range
uniform float gain;
out vec4 shown;

bool isFinite(float v) { return !(isnan(v) || isinf(v)); }
bool isFinite(vec3 v) { return isFinite(v.x) && isFinite(v.y) && isFinite(v.z); }

// Khronos PBR Neutral.
vec3 pbrNeutral(vec3 color) {
  const float start = 0.8 - 0.04;
  const float desaturation = 0.15;
  float least = min(color.r, min(color.g, color.b));
  float offset = least < 0.08 ? least - 6.25 * least * least : 0.04;
  color -= offset;
  float peak = max(color.r, max(color.g, color.b));
  if (peak < start) return color;
  float d = 1.0 - start;
  float newPeak = 1.0 - d * d / (peak + d - start);
  float g = 1.0 - 1.0 / (desaturation * (peak - newPeak) + 1.0);
  vec3 compressed = color * (newPeak / peak);
  return compressed + (newPeak - compressed) * g;
}

vec3 agxContrast(vec3 x) {
  vec3 x2 = x * x;
  vec3 x4 = x2 * x2;
  return 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
}

// Rows, as the engine writes them.
vec3 rows(vec3 a, vec3 b, vec3 c, vec3 v) { return vec3(dot(a, v), dot(b, v), dot(c, v)); }

vec3 agx(vec3 color) {
  const float minEv = -12.47393;
  const float maxEv = 4.026069;
  color = rows(vec3(0.6274, 0.3293, 0.0433), vec3(0.0691, 0.9195, 0.0113), vec3(0.0164, 0.0880, 0.8956), color);
  color = rows(vec3(0.85662715, 0.09512124, 0.048251606), vec3(0.13731897, 0.761242, 0.10143904),
    vec3(0.11189821, 0.07679942, 0.8113024), color);
  color = clamp((log2(max(color, 1e-10)) - minEv) / (maxEv - minEv), 0.0, 1.0);
  color = agxContrast(color);
  color = rows(vec3(1.1271006, -0.11060664, -0.016493939), vec3(-0.14132976, 1.1578237, -0.016493939),
    vec3(-0.14132976, -0.11060664, 1.2519364), color);
  color = pow(max(color, 0.0), vec3(2.2));
  return rows(vec3(1.6605, -0.5876, -0.0728), vec3(-0.1246, 1.1329, -0.0083), vec3(-0.0182, -0.1006, 1.1187), color);
}

vec3 encode(vec3 c) {
  c = clamp(c, 0.0, 1.0);
  return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, vec3(lessThanEqual(c, vec3(0.0031308))));
}

vec3 toDisplay(vec3 radiance, bool isDisplayed) {
  vec3 scaled = radiance * exposure;
  vec3 clean = vec3(
    isnan(scaled.r) ? 0.0 : clamp(scaled.r, 0.0, 1e30),
    isnan(scaled.g) ? 0.0 : clamp(scaled.g, 0.0, 1e30),
    isnan(scaled.b) ? 0.0 : clamp(scaled.b, 0.0, 1e30));
  if (!isDisplayed && toneMap == 0) clean = pbrNeutral(clean);
  if (!isDisplayed && toneMap == 1) clean = agx(clean);
  return encode(clean);
}

const vec3 NONE = vec3(0.16, 0.17, 0.2);

vec3 falseColor(float t) {
  return texture(colors, vec2((clamp(t, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5)).rgb;
}

// Ids come as the four bytes of their integer.
uint toInteger(vec4 bytes) {
  uvec4 b = uvec4(bytes * 255.0 + 0.5);
  return b.x | (b.y << 8) | (b.z << 16) | (b.w << 24);
}

// Neighbouring ids get colours far apart.
vec3 idColor(uint id) {
  uint h = id * 2654435761u;
  h ^= h >> 15;
  h *= 2246822519u;
  h ^= h >> 13;
  float hue = float(h & 1023u) / 1023.0 * 6.0;
  float light = 0.55 + 0.4 * float((h >> 10) & 255u) / 255.0;
  vec3 color = clamp(abs(mod(hue + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0);
  return light * mix(vec3(1.0), color, 0.65);
}

// The distance of two integers, taken before it becomes a float.
float apart(uint a, uint b) { return float(a > b ? a - b : b - a); }

vec3 pictureAt(ivec2 at) {
  vec4 a = texelFetch(first, at, 0);
  if (kind == 4) return a.rgb;
  if (difference) {
    vec4 b = texelFetch(second, at, 0);
    if (kind == 0) {
      if (isFinite(a.rgb) != isFinite(b.rgb)) return vec3(1.0);
      return encode(isFinite(a.rgb) ? abs(b.rgb - a.rgb) * exposure * gain : vec3(0.0));
    }
    if (kind == 1) return encode(abs(b.rgb - a.rgb) / span * gain);
    if (kind == 3 && counted) return falseColor(apart(toInteger(a), toInteger(b)) / span * gain);
    if (kind == 3) return toInteger(a) == toInteger(b) ? vec3(0.0) : vec3(1.0);
    if (isFinite(a.r) != isFinite(b.r)) return vec3(1.0);
    return isFinite(a.r) ? falseColor(abs(b.r - a.r) / span * gain) : NONE;
  }
  if (kind == 0) return toDisplay(a.rgb, displayed.x);
  if (kind == 1) return isFinite(a.rgb) ? clamp((a.rgb - range.x) / span, 0.0, 1.0) : NONE;
  if (kind == 2) return isFinite(a.r) ? falseColor((a.r - range.x) / span) : NONE;
  uint id = toInteger(a);
  if (id == 4294967295u) return NONE;
  return counted ? falseColor(id < low ? 0.0 : apart(id, low) / span) : idColor(id);
}

const vec3 OUTSIDE = vec3(0.09, 0.094, 0.11);

void main() {
  vec2 fragment = vec2(gl_FragCoord.x - pane.x, pane.y + pane.w - gl_FragCoord.y);
  vec2 place = (fragment - origin) / zoom;
  if (any(lessThan(place, vec2(0.0))) || any(greaterThanEqual(place, vec2(size)))) {
    shown = vec4(OUTSIDE, 1.0);
    return;
  }
  // Smaller than life: the mean of what falls into a pixel of the screen, as it would be shown.
  int taps = clamp(int(ceil(1.0 / zoom - 0.01)), 1, 5);
  vec3 sum = vec3(0.0);
  for (int y = 0; y < taps; y++) {
    for (int x = 0; x < taps; x++) {
      vec2 offset = (vec2(x, y) + 0.5) / float(taps) - 0.5;
      sum += pictureAt(clamp(ivec2(floor(place + offset / max(zoom, 1e-3) * (taps > 1 ? 1.0 : 0.0))), ivec2(0), size - 1));
    }
  }
  shown = vec4(sum / float(taps * taps), 1.0);
}`;
