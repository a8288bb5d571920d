import type { Schema } from "../../session/client";
import {
  crossrangeWords,
  degrees,
  downrangeWords,
  fixed,
  metres,
  percent,
  seconds,
  signed,
  speed,
} from "../../words/format";
import classes from "../Panel.module.css";
import { nearestClearance } from "./clearance";

type Prediction = Schema["PredictionView"];

/** Predicted numbers; the spread grows more certain while the rollouts come in. */
export function PreviewNumbers({
  prediction,
  isComplete,
  aim,
  material,
}: {
  prediction: Prediction;
  isComplete: boolean;
  aim: Schema["AimShift"] | null;
  material: Schema["ThrownMaterial"] | null;
}) {
  const { ellipse } = prediction;
  const nearest = nearestClearance(prediction.clearances);
  return (
    <dl className={classes.numbers} data-testid="preview-numbers">
      <dt>Lands on</dt>
      <dd>
        {prediction.lands_on}, {signed(prediction.impact_m[2])} m
      </dd>
      <dt>Error</dt>
      <dd>{downrangeWords(prediction.downrange_error_m)}</dd>
      <dt />
      <dd>{crossrangeWords(prediction.crossrange_error_m)}</dd>
      {material && (
        <>
          <dt>Load</dt>
          <dd>
            {fixed(material.volume_m3)} m³ of {material.name}; the prediction is for a ball
          </dd>
        </>
      )}
      {aim && (
        <>
          <dt>Aim correction v{aim.version_count}</dt>
          <dd>
            {signed(-aim.downrange_m)} m along, {signed(-aim.crossrange_m)} m across
          </dd>
        </>
      )}
      <dt>Spread, 1σ</dt>
      <dd>
        {ellipse
          ? `${fixed(ellipse.sd_downrange_m)} × ${fixed(ellipse.sd_crossrange_m)} m`
          : "computing"}
      </dd>
      {ellipse && (
        <>
          <dt>Rollouts landed{isComplete ? "" : " so far"}</dt>
          <dd>
            {ellipse.landed_count} of {ellipse.rollout_count},{" "}
            {percent(ellipse.landed_count / Math.max(1, ellipse.rollout_count))}
          </dd>
        </>
      )}
      <dt>Release speed</dt>
      <dd>{speed(prediction.release_speed_m_per_s)}</dd>
      <dt>Time to release</dt>
      <dd>{seconds(prediction.release_s, 1)}</dd>
      <dt>Duration</dt>
      <dd>
        {seconds(prediction.duration_s, 1)}, flight {seconds(prediction.flight_s)}
      </dd>
      {nearest && (
        <>
          <dt>Nearest limit</dt>
          <dd>
            {nearest.name},{" "}
            {nearest.margin_m !== null ? metres(nearest.margin_m) : degrees(nearest.margin_rad)}
          </dd>
        </>
      )}
    </dl>
  );
}
