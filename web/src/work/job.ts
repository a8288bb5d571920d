/** A job's parts as the server gives them. */

import type { Schema } from "../session/client";

export type Job = Schema["JobView"];
export type JobSummary = Schema["JobSummary"];
export type JobLoad = Job["loads"][number];
export type Proposal = Job["next"][number];
export type JobFile = Job["file"];
export type Surface = Schema["JobSurface"];
