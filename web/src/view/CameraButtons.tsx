import { Button } from "@mantine/core";
import { IconPlayerPlay } from "@tabler/icons-react";
import classes from "./CameraButtons.module.css";
import { type Camera, useViewRequest } from "./useView";

const CAMERAS: { camera: Camera; label: string }[] = [
  { camera: "3d", label: "Free" },
  { camera: "top", label: "Top" },
  { camera: "side", label: "Side" },
];

/** Where to look from; and the preview once more. */
export function CameraButtons({ hasPreview }: { hasPreview: boolean }) {
  const request = useViewRequest();
  return (
    <div className={classes.buttons}>
      <Button.Group aria-label="Camera">
        {CAMERAS.map(({ camera, label }) => (
          <Button key={camera} variant="default" size="sm" onClick={() => request({ camera })}>
            {label}
          </Button>
        ))}
      </Button.Group>
      {hasPreview && (
        <Button
          variant="default"
          size="sm"
          leftSection={<IconPlayerPlay size={16} aria-hidden />}
          onClick={() => request({ play_preview: true })}
        >
          Play preview
        </Button>
      )}
    </div>
  );
}
