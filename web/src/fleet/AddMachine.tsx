import { Button, Modal, TextInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import classes from "./Fleet.module.css";
import { SetUpProgress, TokenBox } from "./SetUp";
import { useAddMachine } from "./useEnrolment";

/** A new machine: a name, then its one-time token, then what it finds of itself. */
export function AddMachine({ onClose }: { onClose: () => void }) {
  const [name, setName] = useState("");
  const add = useAddMachine();
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    add.mutate({ name: name.trim() });
  };
  const added = add.data;
  return (
    <Modal
      opened
      onClose={onClose}
      title={added ? `Set up ${added.machine.machine_id}` : "Add machine"}
      size="lg"
      centered
    >
      {added ? (
        <div className={classes.dialog}>
          <TokenBox enrolment={added} />
          <SetUpProgress machineId={added.machine.machine_id} />
          <Button size="md" fullWidth variant="default" onClick={onClose}>
            Close
          </Button>
        </div>
      ) : (
        <form onSubmit={submit} className={classes.dialog}>
          <TextInput
            label="Name"
            description="May stay empty; its id comes from the server"
            value={name}
            maxLength={80}
            data-autofocus
            onChange={(event) => setName(event.currentTarget.value)}
          />
          {add.isError && (
            <p className={classes.refusal} role="alert">
              {errorWords(add.error)}
            </p>
          )}
          <Button type="submit" size="md" fullWidth loading={add.isPending}>
            Make a token
          </Button>
        </form>
      )}
    </Modal>
  );
}
