import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { EventStream, type Source, type StreamCallbacks } from "./eventStream";

class FakeSource implements Source {
  listeners: Record<string, (event: unknown) => void> = {};
  isClosed = false;
  addEventListener(kind: string, listener: unknown): void {
    this.listeners[kind] = listener as (event: unknown) => void;
  }
  close(): void {
    this.isClosed = true;
  }
  emit(kind: "open" | "close", event: object = {}): void {
    this.listeners[kind]?.(event);
  }
  say(...events: object[]): void {
    this.listeners.message?.({ data: JSON.stringify(events) });
  }
}

function setup(resync: StreamCallbacks["resync"] = () => Promise.resolve()) {
  const sources: FakeSource[] = [];
  const callbacks = {
    resync: vi.fn(resync),
    onEvent: vi.fn(),
    onData: vi.fn(),
    onOpen: vi.fn(),
    onRefused: vi.fn(),
  };
  const stream = new EventStream(() => {
    const source = new FakeSource();
    sources.push(source);
    return source;
  }, callbacks);
  stream.start();
  const last = () => sources.at(-1) as FakeSource;
  return { stream, sources, last, callbacks };
}

const settle = () => vi.advanceTimersByTimeAsync(0);

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

describe("EventStream", () => {
  it("is open only after the present state was read", async () => {
    const { last, callbacks } = setup();
    expect(callbacks.onOpen).not.toHaveBeenCalled();
    last().emit("open");
    await settle();
    expect(callbacks.resync).toHaveBeenCalledTimes(1);
    expect(callbacks.onOpen).toHaveBeenCalledExactlyOnceWith(true);
  });

  it("reconnects and resyncs after a break, slower each time", async () => {
    const { sources, last, callbacks } = setup();
    last().emit("open");
    await settle();
    last().emit("close");
    expect(callbacks.onOpen).toHaveBeenLastCalledWith(false);
    expect(sources[0]?.isClosed).toBe(true);
    for (const wait_ms of [500, 1000, 2000, 4000, 5000, 5000]) {
      const before = sources.length;
      await vi.advanceTimersByTimeAsync(wait_ms - 1);
      expect(sources).toHaveLength(before);
      await vi.advanceTimersByTimeAsync(1);
      expect(sources).toHaveLength(before + 1);
      last().emit("close");
    }
    await vi.advanceTimersByTimeAsync(5000);
    last().emit("open");
    await settle();
    expect(callbacks.resync).toHaveBeenCalledTimes(2);
    expect(callbacks.onOpen).toHaveBeenLastCalledWith(true);
  });

  it("counts a failed resync as a failed connection", async () => {
    const { last, callbacks, sources } = setup(() => Promise.reject(new Error("401")));
    last().emit("open");
    await settle();
    expect(callbacks.onOpen).toHaveBeenLastCalledWith(false);
    await vi.advanceTimersByTimeAsync(500);
    expect(sources).toHaveLength(2);
  });

  it("delivers what comes while the present state is read after it, since it may be newer", async () => {
    let end = () => {};
    const isRead = new Promise<void>((resolve) => {
      end = resolve;
    });
    const { last, callbacks } = setup(() => isRead);
    last().emit("open");
    last().say({ kind: "alert.updated" });
    await settle();
    expect(callbacks.onData).toHaveBeenCalled();
    expect(callbacks.onEvent).not.toHaveBeenCalled();
    end();
    await settle();
    last().say({ kind: "machine.state" });
    const kinds = callbacks.onEvent.mock.calls.map(([event]) => event.kind);
    expect(kinds).toEqual(["alert.updated", "machine.state"]);
  });

  it("delivers events, and pings as signs of life only", async () => {
    const { last, callbacks } = setup();
    last().emit("open");
    await settle();
    callbacks.onData.mockClear();
    last().say({ kind: "machine.state" }, { kind: "of.a.newer.server" }, { kind: "alert" });
    last().say();
    expect(callbacks.onEvent.mock.calls).toEqual([
      [{ kind: "machine.state" }],
      [{ kind: "alert" }],
    ]);
    expect(callbacks.onData).toHaveBeenCalledTimes(2);
  });

  it("tells why the server refuses it, and tries again later", async () => {
    const { last, callbacks, sources } = setup();
    last().emit("close", { code: 4429, reason: "operator has 32 event streams open" });
    expect(callbacks.onRefused).toHaveBeenCalledExactlyOnceWith(
      "operator has 32 event streams open",
    );
    await vi.advanceTimersByTimeAsync(500);
    expect(sources).toHaveLength(2);
    last().emit("close", { code: 1006, reason: "" });
    expect(callbacks.onRefused).toHaveBeenCalledTimes(1);
  });

  it("ignores what an abandoned connection still says", async () => {
    const { stream, sources, callbacks } = setup();
    stream.kick();
    sources[0]?.say({ kind: "machine.state" });
    sources[0]?.emit("close");
    expect(callbacks.onEvent).not.toHaveBeenCalled();
    expect(sources).toHaveLength(2);
  });

  it("stays closed", async () => {
    const { stream, sources } = setup();
    stream.close();
    stream.start();
    await vi.advanceTimersByTimeAsync(60_000);
    expect(sources).toHaveLength(1);
  });
});
