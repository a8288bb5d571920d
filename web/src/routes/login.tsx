import { Button, PasswordInput, TextInput } from "@mantine/core";
import { useMutation, useQueryClient } from "@tanstack/react-query";
import { useRouter, useSearch } from "@tanstack/react-router";
import { useState } from "react";
import { ApiError, api, take } from "../session/client";
import { ME } from "../session/queries";
import { errorWords } from "../words/errors";
import classes from "./login.module.css";

/** Only paths of this console: a crafted link must not lead elsewhere. */
export function safeBack(back: string | undefined): string {
  return back?.startsWith("/") && !back.startsWith("//") && !back.startsWith("/login")
    ? back
    : "/operate";
}

function loginWords(error: unknown): string {
  if (error instanceof ApiError && error.status === 401) return error.message;
  return errorWords(error);
}

/** Sign in, and go back to where the session ended. */
export function LoginPage() {
  const { back } = useSearch({ from: "/login" });
  const router = useRouter();
  const client = useQueryClient();
  const [username, setUsername] = useState("");
  const [password, setPassword] = useState("");
  const login = useMutation({
    mutationFn: () => take(api.POST("/api/v1/auth/login", { body: { username, password } })),
    onSuccess: (session) => {
      client.setQueryData(ME, session);
      router.history.replace(safeBack(back));
    },
  });
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    login.mutate();
  };
  return (
    <main className={classes.page}>
      <form className={classes.card} onSubmit={submit}>
        <h1 className={classes.name}>
          <img src="/favicon.svg" alt="" width="32" height="32" /> Downrange
        </h1>
        <TextInput
          label="Name"
          size="md"
          autoComplete="username"
          autoFocus
          required
          withAsterisk={false}
          value={username}
          onChange={(event) => setUsername(event.currentTarget.value)}
        />
        <PasswordInput
          label="Password"
          size="md"
          autoComplete="current-password"
          required
          withAsterisk={false}
          value={password}
          onChange={(event) => setPassword(event.currentTarget.value)}
        />
        {login.isError && (
          <p className={classes.error} role="alert">
            {loginWords(login.error)}
          </p>
        )}
        <Button type="submit" size="md" fullWidth loading={login.isPending}>
          Sign in
        </Button>
        <p className={classes.note}>
          This page cannot stop a machine. The emergency stop is the red button on the machine and
          on its remote control. Once you are signed in, STOP is at the top right of every page
          (Shift+S); it stops the software and is not an emergency stop.
        </p>
      </form>
    </main>
  );
}
