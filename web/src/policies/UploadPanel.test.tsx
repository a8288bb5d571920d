import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { ApiError, api } from "../session/client";
import { stubResizeObserver } from "../testing";
import { UploadPanel } from "./UploadPanel";
import * as upload from "./upload";

const WHOLE = ["policy.onnx", "card.json", "golden_vectors.json"].map(
  (name) => new File(["x"], name),
);

function show(permissions: string[]) {
  vi.spyOn(api, "GET").mockImplementation((() =>
    Promise.resolve({ data: { permissions }, response: new Response() })) as never);
  render(
    <QueryClientProvider client={new QueryClient()}>
      <MantineProvider>
        <UploadPanel />
      </MantineProvider>
    </QueryClientProvider>,
  );
}

const send = () => screen.getByRole("button", { name: "Upload" }) as HTMLButtonElement;

async function chooseWhole() {
  const drop = await screen.findByTestId("drop-policy");
  fireEvent.drop(drop, { dataTransfer: { files: WHOLE } });
  fireEvent.change(screen.getByLabelText(/Why/), { target: { value: "retrained" } });
}

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
});

describe("the upload of a version", () => {
  it("is not offered to those who may not upload", async () => {
    show(["view"]);
    await waitFor(() => expect(api.GET).toHaveBeenCalled());
    expect(screen.queryByTestId("drop-policy")).toBeNull();
  });

  it("needs all files and a reason, and says what is missing", async () => {
    show(["policy.upload"]);
    const drop = await screen.findByTestId("drop-policy");
    expect(send().disabled).toBe(true);
    fireEvent.drop(drop, { dataTransfer: { files: WHOLE.slice(0, 2) } });
    expect(screen.getByText(/^golden_vectors\.json is missing/)).toBeTruthy();
    fireEvent.drop(drop, { dataTransfer: { files: WHOLE } });
    expect(send().disabled).toBe(true);
    await chooseWhole();
    expect(send().disabled).toBe(false);
  });

  it("tells how far it is, and that it is done", async () => {
    let finish = (_: unknown) => {};
    let report = (_: number) => {};
    vi.spyOn(upload, "uploadPolicy").mockImplementation((_files, _reason, onProgress) => {
      report = onProgress;
      return new Promise((resolve) => {
        finish = resolve as never;
      });
    });
    show(["policy.upload"]);
    await chooseWhole();
    fireEvent.click(send());
    await screen.findByText("0 % sent");
    report(0.5);
    await screen.findByText("50 % sent");
    report(1);
    await screen.findByText(/The server checks it/);
    finish({ policy_id: "v8" });
    await screen.findByText(/v8 is uploaded\. No machine loads it before it is approved/);
  });

  it("is cancelled while it is sent", async () => {
    vi.spyOn(upload, "uploadPolicy").mockImplementation(
      (_files, _reason, _onProgress, signal) =>
        new Promise((_, reject) =>
          signal.addEventListener("abort", () =>
            reject(new ApiError(0, "cancelled", "Cancelled.")),
          ),
        ),
    );
    show(["policy.upload"]);
    await chooseWhole();
    fireEvent.click(send());
    fireEvent.click(await screen.findByRole("button", { name: "Cancel the upload" }));
    expect((await screen.findByRole("alert")).textContent).toBe("Cancelled.");
    expect(screen.queryByRole("button", { name: "Cancel the upload" })).toBeNull();
    expect(send().disabled).toBe(false);
  });

  it("gives the server's sentence, and goes on from there", async () => {
    const refusal = new ApiError(400, "policy_refused", "v8 has no golden vectors.");
    vi.spyOn(upload, "uploadPolicy").mockRejectedValue(refusal);
    show(["policy.upload"]);
    await chooseWhole();
    fireEvent.click(send());
    expect((await screen.findByRole("alert")).textContent).toBe("v8 has no golden vectors.");
    await chooseWhole();
    expect(screen.queryByRole("alert")).toBeNull();
    expect(send().disabled).toBe(false);
  });
});
