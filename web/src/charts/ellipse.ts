/** Sigma ellipses of two correlated errors, as points and as SVG paths. */

type Spread = {
  mean_downrange_error_m: number;
  mean_crossrange_error_m: number;
  sd_downrange_m: number;
  sd_crossrange_m: number;
  correlation_ratio: number;
};

const POINT_COUNT = 72;

/**
 * Points of the ellipse at `sigma` standard deviations: mean + sigma L u with the Cholesky factor L of
 * the covariance and unit vectors u.
 */
export function ellipsePoints(spread: Spread, sigma: number): { x_m: number; y_m: number }[] {
  const { correlation_ratio: r, sd_downrange_m: sx, sd_crossrange_m: sy } = spread;
  const across = sy * Math.sqrt(Math.max(0, 1 - r * r));
  return Array.from({ length: POINT_COUNT + 1 }, (_, index) => {
    const angle = (2 * Math.PI * index) / POINT_COUNT;
    const cos = Math.cos(angle);
    const sin = Math.sin(angle);
    return {
      x_m: spread.mean_downrange_error_m + sigma * sx * cos,
      y_m: spread.mean_crossrange_error_m + sigma * (r * sy * cos + across * sin),
    };
  });
}

/** The same as an SVG path; `x` and `y` map metres to pixels. */
export function ellipsePath(
  spread: Spread,
  sigma: number,
  x: (m: number) => number,
  y: (m: number) => number,
): string {
  const points = ellipsePoints(spread, sigma);
  return `M${points.map((p) => `${x(p.x_m).toFixed(2)} ${y(p.y_m).toFixed(2)}`).join("L")}Z`;
}

/** How many sigma a point lies from the mean (Mahalanobis distance); null for a degenerate spread. */
export function sigmaDistance(
  spread: Spread,
  downrange_m: number,
  crossrange_m: number,
): number | null {
  const { correlation_ratio: r, sd_downrange_m: sx, sd_crossrange_m: sy } = spread;
  const rest = 1 - r * r;
  if (sx <= 0 || sy <= 0 || rest <= 1e-9) return null;
  const u = (downrange_m - spread.mean_downrange_error_m) / sx;
  const v = (crossrange_m - spread.mean_crossrange_error_m) / sy;
  return Math.sqrt((u * u - 2 * r * u * v + v * v) / rest);
}
