// Colours of points as RGBA bytes, packed into one integer each.

export const MODES = ["sensor", "intensity", "ring", "height", "time", "object"];
export const DIFFUSE = 100; // intensities above are of retro-reflectors
export const SHADES = DIFFUSE + 1;

export function rgb(code) {
  return [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16));
}

export function packed([red, green, blue]) {
  return (255 << 24) | (blue << 16) | (green << 8) | red;
}

// `steps` colours along the scale's stops.
export function ramp(stops, steps) {
  const colours = stops.map(rgb);
  return Int32Array.from({ length: steps }, (_, i) => {
    const at = (i / (steps - 1)) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    return packed(colours[low].map((value, c) => value + (at - low) * (colours[low + 1][c] - value)));
  });
}

// 101 shades of each colour, by intensity: darker for dark objects.
export function shades(codes) {
  const light = Array.from({ length: SHADES }, (_, i) => 0.7 + 0.3 * Math.sqrt(i / DIFFUSE));
  return Int32Array.from(codes.flatMap((code) => light.map((factor) => packed(rgb(code).map((value) => factor * value)))));
}
