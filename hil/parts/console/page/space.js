// Geometry: quaternions in the convention of the bench (scalar last, A(q) transforms components from H to c).

export function matrix([x, y, z, w]) {
  return [
    [x * x - y * y - z * z + w * w, 2 * (x * y + z * w), 2 * (x * z - y * w)],
    [2 * (x * y - z * w), -x * x + y * y - z * z + w * w, 2 * (y * z + x * w)],
    [2 * (x * z + y * w), 2 * (y * z - x * w), -x * x - y * y + z * z + w * w],
  ];
}

export const apply = (a, v) => a.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
export const applyBack = (a, v) => [0, 1, 2].map((i) => a[0][i] * v[0] + a[1][i] * v[1] + a[2][i] * v[2]);
export const plus = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
export const norm = (a) => Math.hypot(...a);
