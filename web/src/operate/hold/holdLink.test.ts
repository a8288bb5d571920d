import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { FRESH_LIMIT_MS, HoldLink, holdUrl, type Socket } from "./holdLink";

class FakeSocket implements Socket {
  readyState = 1;
  sent: { throw_id: string; holding: boolean; machine_t_mono_ns: number | null }[] = [];
  listeners: Record<string, (event?: { data: string }) => void> = {};
  isClosed = false;
  send(text: string): void {
    this.sent.push(JSON.parse(text));
  }
  close(): void {
    this.isClosed = true;
  }
  addEventListener(kind: string, listener: unknown): void {
    this.listeners[kind] = listener as () => void;
  }
  answer(time: number | null): void {
    this.listeners.message?.({ data: JSON.stringify({ machine_t_mono_ns: time }) });
  }
}

describe("HoldLink", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  it("speaks 20 times a second while it beats, and once that it rests", () => {
    const socket = new FakeSocket();
    const link = new HoldLink(() => socket, vi.fn());
    link.beat("t1");
    for (let tick = 0; tick < 20; tick++) {
      link.fresh();
      vi.advanceTimersByTime(50);
    }
    expect(socket.sent).toHaveLength(21);
    link.rest();
    vi.advanceTimersByTime(1000);
    expect(socket.sent).toHaveLength(22);
    expect(socket.sent.at(-1)).toMatchObject({ throw_id: "t1", holding: false });
  });

  it("echoes the machine's newest time, and speaks at once when it hears the first", () => {
    const socket = new FakeSocket();
    const link = new HoldLink(() => socket, vi.fn());
    link.beat("t1");
    socket.answer(7e15);
    expect(socket.sent.map((message) => message.machine_t_mono_ns)).toEqual([null, 7e15]);
    socket.answer(7e15 + 5e7);
    expect(socket.sent).toHaveLength(2);
    vi.advanceTimersByTime(100);
    expect(socket.sent.slice(2).map((message) => message.machine_t_mono_ns)).toEqual([
      7e15 + 5e7,
      7e15 + 5e7,
    ]);
  });

  it("falls silent when the page hangs, and speaks again when it is back", () => {
    const socket = new FakeSocket();
    const link = new HoldLink(() => socket, vi.fn());
    link.beat("t1");
    vi.advanceTimersByTime(FRESH_LIMIT_MS);
    const said = socket.sent.length;
    expect(said).toBe(1 + FRESH_LIMIT_MS / 50);
    vi.advanceTimersByTime(5000);
    expect(socket.sent).toHaveLength(said);
    link.fresh();
    vi.advanceTimersByTime(50);
    expect(socket.sent).toHaveLength(said + 1);
    expect(socket.sent.every((message) => message.holding)).toBe(true);
  });

  it("never queues what cannot be sent", () => {
    const socket = new FakeSocket();
    const link = new HoldLink(() => socket, vi.fn());
    socket.readyState = 0;
    link.beat("t1");
    vi.advanceTimersByTime(200);
    expect(socket.sent).toHaveLength(0);
    socket.readyState = 1;
    vi.advanceTimersByTime(50);
    expect(socket.sent).toHaveLength(1);
  });

  it("reports a break once, also before the first beat", () => {
    for (const isBeating of [false, true]) {
      const onLost = vi.fn();
      const socket = new FakeSocket();
      const link = new HoldLink(() => socket, onLost);
      if (isBeating) link.beat("t1");
      socket.listeners.error?.();
      socket.listeners.close?.();
      expect(onLost).toHaveBeenCalledTimes(1);
    }
  });

  it("reports no break that it made itself", () => {
    const onLost = vi.fn();
    const socket = new FakeSocket();
    new HoldLink(() => socket, onLost).close();
    socket.listeners.close?.();
    expect(onLost).not.toHaveBeenCalled();
  });

  it("says that it let go before it closes", () => {
    const socket = new FakeSocket();
    const link = new HoldLink(() => socket, vi.fn());
    link.beat("t1");
    link.close();
    expect(socket.sent.at(-1)?.holding).toBe(false);
    expect(socket.isClosed).toBe(true);
  });

  it("follows the page's scheme", () => {
    const at = (href: string) => holdUrl("m 1", new URL(href) as unknown as Location);
    expect(at("https://yard:8443/operate")).toBe("wss://yard:8443/api/v1/machines/m%201/hold");
    expect(at("http://127.0.0.1:8000/")).toBe("ws://127.0.0.1:8000/api/v1/machines/m%201/hold");
  });
});
