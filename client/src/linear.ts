/** x of A x = b for a symmetric, positive definite A, by Cholesky's factors. */
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
