import { useEffect, useState } from "react";
import { fixed } from "../words/format";
import { ActionFooter } from "./ActionFooter";
import classes from "./Panel.module.css";
import { PreviewStep } from "./preview/PreviewStep";
import { ResultStep } from "./ResultStep";
import { Step } from "./Step";
import { STEPS, type StepName } from "./steps";
import { ThrowStep } from "./ThrowStep";
import { TargetStep } from "./target/TargetStep";
import { fromPoint } from "./target/target";
import { targetSummary } from "./target/targetSummary";
import type { Operate } from "./useOperate";

/** Target, Preview, Throw, Result: the present step open, the others as one line. */
export function OperatePanel({ operate }: { operate: Operate }) {
  const { machine, mode, target, plan, step } = operate;
  // Steps opened by hand stay open until the throw moves on.
  const [opened, setOpened] = useState<readonly StepName[]>([]);
  // The first digit of a range is a target already; the fields must not close under the fingers.
  const [isAiming, setAiming] = useState(false);
  // biome-ignore lint/correctness/useExhaustiveDependencies: a new present step closes the others
  useEffect(() => setOpened([]), [step]);
  if (!machine) return null;

  const isOpen = (name: StepName) =>
    (name === step) !== opened.includes(name) || (name === "target" && isAiming);
  const toggle = (name: StepName) =>
    setOpened(opened.includes(name) ? opened.filter((n) => n !== name) : [...opened, name]);
  const summaries = summariesOf(operate);
  const contents: Record<StepName, React.ReactNode> = {
    target: (
      <TargetStep
        machine={machine}
        mode={mode}
        onMode={operate.setMode}
        target={target}
        onTarget={operate.setTarget}
        onEditing={setAiming}
        problem={operate.problem}
        pace_ratio={operate.pace_ratio}
        onPace={operate.setPace}
      />
    ),
    preview: (
      <PreviewStep machine={machine} plan={plan} estimate={operate.estimate} gate={operate.gate} />
    ),
    throw: <ThrowStep operate={operate} />,
    result: operate.result ? (
      <ResultStep
        thrown={operate.result}
        plan={plan}
        onAgain={operate.throwAgain}
        isMarking={operate.isMarking}
        onMarking={operate.setMarking}
      />
    ) : (
      <p className={classes.note}>No throw yet.</p>
    ),
  };
  return (
    <aside className={classes.panel} aria-label="Throw">
      <div className={classes.card}>
        <div className={classes.steps}>
          {STEPS.map((name, index) => (
            <Step
              key={name}
              number={index + 1}
              title={TITLES[name]}
              summary={summaries[name]}
              isOpen={isOpen(name)}
              isPresent={name === step}
              onToggle={() => toggle(name)}
            >
              {contents[name]}
            </Step>
          ))}
        </div>
      </div>
      <div className={classes.action}>
        <ActionFooter
          machine={machine}
          gate={operate.gate}
          control={operate.control}
          hasResult={operate.result !== null}
          onPreviewAgain={operate.previewAgain}
          onOtherMode={() => operate.setMode(mode === "2d" ? "3d" : "2d")}
          onHeight={(z_m) => target && operate.setTarget(fromPoint(target.x_m, target.y_m, z_m))}
        />
      </div>
    </aside>
  );
}

const TITLES: Record<StepName, string> = {
  target: "Target",
  preview: "Preview",
  throw: "Throw",
  result: "Result",
};

function summariesOf({ mode, target, plan, result }: Operate): Record<StepName, string> {
  const ellipse = plan?.prediction?.ellipse;
  const preview = ellipse
    ? `${fixed(ellipse.sd_downrange_m)} × ${fixed(ellipse.sd_crossrange_m)} m, 1σ`
    : (plan?.state ?? "");
  return {
    target: targetSummary(mode, target),
    preview,
    throw: "",
    result: result ? (result.outcome ?? "") : "",
  };
}
