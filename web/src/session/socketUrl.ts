/** Address of a WebSocket of this origin. */
export function socketUrl(path: string, base: Location = window.location): string {
  const scheme = base.protocol === "https:" ? "wss:" : "ws:";
  return `${scheme}//${base.host}${path}`;
}
