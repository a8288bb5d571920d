import { Button, Modal, TagsInput, TextInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import classes from "./Fleet.module.css";
import { useEditMachine } from "./useFleet";

const MOST_TAGS = 8;
const MOST_LETTERS = 24;

type Props = { machineId: string; name: string; tags: readonly string[]; onClose: () => void };

/** How people call and sort a machine; its id stays. */
export function EditMachine({ machineId, name, tags, onClose }: Props) {
  const [newName, setName] = useState(name);
  const [newTags, setTags] = useState<string[]>([...tags]);
  const edit = useEditMachine(machineId);
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    edit.mutate({ name: newName.trim(), tags: newTags }, { onSuccess: onClose });
  };
  return (
    <Modal opened onClose={onClose} title={`Name and tags of ${machineId}`} centered>
      <form onSubmit={submit} className={classes.dialog}>
        <TextInput
          label="Name"
          description={`Shown beside ${machineId}; may stay empty`}
          value={newName}
          maxLength={80}
          data-autofocus
          onChange={(event) => setName(event.currentTarget.value)}
        />
        <TagsInput
          label="Tags"
          description="Enter ends a tag; the fleet is searched by them"
          value={newTags}
          maxTags={MOST_TAGS}
          onChange={(values) => setTags(values.map((tag) => tag.slice(0, MOST_LETTERS)))}
        />
        {edit.isError && (
          <p className={classes.refusal} role="alert">
            {errorWords(edit.error)}
          </p>
        )}
        <Button type="submit" size="md" fullWidth loading={edit.isPending}>
          Keep
        </Button>
      </form>
    </Modal>
  );
}
