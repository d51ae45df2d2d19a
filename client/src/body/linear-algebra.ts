/** Vectors x, y, z, and rotation matrices (3 × 3, row by row), whose columns are the axes of the rotated frame. */
export type Vector = [x: number, y: number, z: number];
export type Axes = readonly number[];

/** The rotation matrix of a unit quaternion w, x, y, z. */
export function fromQuaternion([w, x, y, z]: readonly [number, number, number, number]): Axes {
  return [
    ...[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    ...[2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    ...[2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The rotation matrix of intrinsic Euler angles: Rx Ry Rz. */
export function fromEulerXYZ(x: number, y: number, z: number): Axes {
  const [cx, cy, cz] = [Math.cos(x), Math.cos(y), Math.cos(z)];
  const [sx, sy, sz] = [Math.sin(x), Math.sin(y), Math.sin(z)];
  return [
    ...[cy * cz, -cy * sz, sy],
    ...[cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
    ...[sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
  ];
}

/** The inverse of `fromEulerXYZ`. */
export function toEulerXYZ(axes: Axes): Vector {
  const [m00, m01, m02, , , m12, , , m22] = axes as [number, number, number, ...number[]];
  return [Math.atan2(-m12!, m22!), Math.atan2(m02, Math.hypot(m12!, m22!)), Math.atan2(-m01, m00)];
}

/** a b */
export function multiply(a: Axes, b: Axes): Axes {
  return product(a, 3, 1, b);
}

/** aᵀ b */
export function multiplyTransposed(a: Axes, b: Axes): Axes {
  return product(a, 1, 3, b);
}

function product(a: Axes, row: number, column: number, b: Axes): Axes {
  const out = new Array<number>(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) {
      const at = i * row;
      out[3 * i + j] = a[at]! * b[j]! + a[at + column]! * b[3 + j]! + a[at + 2 * column]! * b[6 + j]!;
    }
  return out;
}

/** a v */
export function rotate(axes: Axes, [x, y, z]: Vector): Vector {
  const row = (i: number) => axes[i]! * x + axes[i + 1]! * y + axes[i + 2]! * z;
  return [row(0), row(3), row(6)];
}

/** aᵀ v */
export function rotateInverse(axes: Axes, [x, y, z]: Vector): Vector {
  const column = (j: number) => axes[j]! * x + axes[j + 3]! * y + axes[j + 6]! * z;
  return [column(0), column(1), column(2)];
}

/** One axis of a frame: 0 is x, 1 is y, 2 is z. */
export function axis(axes: Axes, index: 0 | 1 | 2): Vector {
  return [axes[index]!, axes[index + 3]!, axes[index + 6]!];
}

export function cross([ax, ay, az]: Vector, [bx, by, bz]: Vector): Vector {
  return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
}

/** a + share · b */
export function addScaled(a: Vector, b: Vector, share = 1): Vector {
  return [a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]];
}

/** The rotation vector from one rotation to another; its length is the angle. */
export function rotationVector(from: Axes, to: Axes): Vector {
  const [a, b] = [from, to];
  const entry = (i: number, j: number) =>
    b[3 * i]! * a[3 * j]! + b[3 * i + 1]! * a[3 * j + 1]! + b[3 * i + 2]! * a[3 * j + 2]!;
  const [x, y, z] = [entry(2, 1) - entry(1, 2), entry(0, 2) - entry(2, 0), entry(1, 0) - entry(0, 1)];
  const sine = 0.5 * Math.hypot(x, y, z);
  const angle = Math.atan2(sine, 0.5 * (entry(0, 0) + entry(1, 1) + entry(2, 2) - 1));
  const scale = sine > 1e-12 ? (0.5 * angle) / sine : 0.5;
  return [scale * x, scale * y, scale * z];
}

/** Solves A x = b for a symmetric, positive definite A by Cholesky decomposition. */
export function solveSymmetric(a: readonly number[][], b: readonly number[]): number[] {
  const factor = cholesky(a);
  const x = [...b];
  for (let i = 0; i < x.length; i++) {
    for (let j = 0; j < i; j++) x[i]! -= factor[i]![j]! * x[j]!;
    x[i]! /= factor[i]![i]!;
  }
  for (let i = x.length - 1; i >= 0; i--) {
    for (let j = i + 1; j < x.length; j++) x[i]! -= factor[j]![i]! * x[j]!;
    x[i]! /= factor[i]![i]!;
  }
  return x;
}

/** The lower triangle L of A = L Lᵀ. */
function cholesky(a: readonly number[][]): number[][] {
  const factor: number[][] = [];
  for (const [i, row] of a.entries()) {
    factor.push([]);
    for (let j = 0; j <= i; j++) {
      let rest = row[j]!;
      for (let k = 0; k < j; k++) rest -= factor[i]![k]! * factor[j]![k]!;
      factor[i]!.push(i === j ? Math.sqrt(rest) : rest / factor[j]![j]!);
    }
  }
  return factor;
}
