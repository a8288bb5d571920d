/** What the 3D view in its iframe tells the console around it (docs/viewer.md). */

export type ViewerState =
  | "loading"
  | "connected"
  | "ground"
  | "drawn"
  | "disconnected"
  | "signed_out"
  | "unsupported";

export type ViewerNews = { state: ViewerState; detail: string };

const STATES: readonly string[] = [
  "connected",
  "ground",
  "drawn",
  "disconnected",
  "signed_out",
  "unsupported",
];

/** The news in a window message; null for messages of anybody else. */
export function readNews(data: unknown, origin: string, ownOrigin: string): ViewerNews | null {
  if (origin !== ownOrigin || typeof data !== "object" || data === null) return null;
  const { source, state, detail } = data as Record<string, unknown>;
  if (source !== "downrange-viewer" || typeof state !== "string" || !STATES.includes(state))
    return null;
  return { state: state as ViewerState, detail: typeof detail === "string" ? detail : "" };
}

/** One sentence over the view where it shows nothing true; empty when it does. */
export function viewerSentence({ state, detail }: ViewerNews): string {
  switch (state) {
    case "loading":
    case "connected":
      return "Loading the 3D view";
    case "ground":
      return "The machine is not drawn yet.";
    case "disconnected":
      return "The 3D view is not live. It reconnects by itself.";
    case "signed_out":
      return "The 3D view needs a new sign-in.";
    case "unsupported":
      return `${detail || "This browser cannot show the 3D view."} Use the fields at the right.`;
    case "drawn":
      return "";
  }
}

const MODIFIERS = ["shiftKey", "ctrlKey", "altKey", "metaKey", "repeat"] as const;

/** A key that was pressed while the view had the keyboard, as an event for this document; else null. */
export function readKey(data: unknown, origin: string, ownOrigin: string): KeyboardEvent | null {
  if (origin !== ownOrigin || typeof data !== "object" || data === null) return null;
  const { source, type, init } = data as Record<string, unknown>;
  if (source !== "downrange-viewer" || (type !== "keydown" && type !== "keyup")) return null;
  if (typeof init !== "object" || init === null) return null;
  const { key, code, ...rest } = init as Record<string, unknown>;
  if (typeof key !== "string" || typeof code !== "string") return null;
  const modifiers = Object.fromEntries(MODIFIERS.map((name) => [name, rest[name] === true]));
  return new KeyboardEvent(type, { key, code, ...modifiers, bubbles: true, cancelable: true });
}
