/** Which logs were refused, read out of a diagnosis's evidence. */

export type Reason = { name: string; why: string };

export function refusedOf(evidence: Record<string, unknown>): Reason[] {
  return records(evidence.refused).map((entry) => ({
    name:
      String(entry.path ?? "")
        .split("/")
        .at(-1) ?? "",
    why: String(entry.reason ?? ""),
  }));
}

function records(value: unknown): Record<string, unknown>[] {
  if (!Array.isArray(value)) return [];
  return value.filter((item): item is Record<string, unknown> => {
    return typeof item === "object" && item !== null && !Array.isArray(item);
  });
}
