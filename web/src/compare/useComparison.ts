/** Two versions side by side. */

import { useQuery } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";

export type Comparison = Schema["PolicyComparisonView"];
export type Difference = Schema["DifferenceView"];

export function useComparison(a: string | null, b: string | null) {
  return useQuery({
    queryKey: ["policy-comparison", a, b],
    enabled: a !== null && b !== null,
    queryFn: () =>
      take(api.GET("/api/v1/policies/compare", { params: { query: { a: a ?? "", b: b ?? "" } } })),
  });
}
