import type { MachinePhase } from "./phase";

/** A shape of its own for every state, so that colour is never the only sign. */
const SHAPES: Record<MachinePhase, React.ReactNode> = {
  disarmed: <circle cx="8" cy="8" r="5.5" fill="none" stroke="currentColor" strokeWidth="2" />,
  armed: (
    <>
      <circle cx="8" cy="8" r="6" fill="none" stroke="currentColor" strokeWidth="1.6" />
      <circle cx="8" cy="8" r="3" fill="currentColor" />
    </>
  ),
  aligning: (
    <path d="M8 2a6 6 0 1 1-6 6M2 3v5h5" fill="none" stroke="currentColor" strokeWidth="2" />
  ),
  throwing: <path d="M3 2.5 13.5 8 3 13.5z" fill="currentColor" />,
  committed: <path d="M1.5 3 8 8l-6.5 5zM8 3l6.5 5L8 13z" fill="currentColor" />,
  settling: (
    <path d="M1 8c2.3-6 4.6-6 7 0s4.7 4 7 0" fill="none" stroke="currentColor" strokeWidth="2" />
  ),
  stopped: <rect x="2.5" y="2.5" width="11" height="11" fill="currentColor" />,
  fault: (
    <path
      d="M8 1 15.5 14.5H.5zM7 6v4h2V6zm0 5.2v1.8h2v-1.8z"
      fill="currentColor"
      fillRule="evenodd"
    />
  ),
  lost: <path d="m3 3 10 10M13 3 3 13" fill="none" stroke="currentColor" strokeWidth="2.4" />,
  never_seen: (
    <circle
      cx="8"
      cy="8"
      r="5.5"
      fill="none"
      stroke="currentColor"
      strokeWidth="2"
      strokeDasharray="2.5 2.5"
    />
  ),
};

export function LampMark({ phase }: { phase: MachinePhase }) {
  return (
    <svg width="16" height="16" viewBox="0 0 16 16" aria-hidden="true" focusable="false">
      {SHAPES[phase]}
    </svg>
  );
}
