// Runs before the viewer in its iframe: keeps it to our own server, keeps it reconnecting, and joins it
// to the console around it (same origin). What it tells the console stands in docs/viewer.md.
(() => {
  "use strict";
  const theme = new URLSearchParams(location.search).get("theme");
  if (theme === "dark" || theme === "light") document.documentElement.dataset.theme = theme;
  // The viewer takes a server's address from the query; ours is the only one there is.
  history.replaceState(null, "", location.pathname);

  let isEnded = false;
  const tell = (state, detail = "") => {
    if (window.parent !== window) {
      window.parent.postMessage({ source: "downrange-viewer", state, detail }, location.origin);
    }
  };

  // The viewer retries only while its document has the focus; in an iframe it seldom does.
  document.hasFocus = () => !isEnded && document.visibilityState === "visible";
  document.addEventListener("visibilitychange", () => window.dispatchEvent(new Event("focus")));

  const closed = async () => {
    tell("disconnected");
    try {
      const answer = await fetch("/viewer/status", { headers: { Accept: "application/json" } });
      if (answer.status === 401) {
        isEnded = true;
        tell("signed_out");
        window.dispatchEvent(new Event("blur"));
      }
    } catch {
      // The server is away; the viewer keeps trying once a second.
    }
  };
  // The sky is the page behind the picture: it follows the scene's theme, which the console may change.
  const colour = (messages) => {
    const news = messages.findLast((message) => message.type === "ThemeConfigurationMessage");
    if (news) document.documentElement.dataset.theme = news.dark_mode ? "dark" : "light";
  };
  // The viewer sorts Gaussian splats with a module that compiles code from text, which this page's policy
  // forbids. Nothing here draws splats: the module is never loaded, and nothing waits for it.
  const nativeFetch = window.fetch;
  window.fetch = (resource, options) => {
    const isSorter = typeof resource === "string" && resource.startsWith("data:application/wasm");
    return isSorter ? new Promise(() => {}) : nativeFetch(resource, options);
  };
  // The viewer prevents the default of a press on what can be dragged, from a listener that it declares
  // passive; the browser then says that it cannot, on every press.
  const nativeListen = EventTarget.prototype.addEventListener;
  EventTarget.prototype.addEventListener = function (type, listener, options) {
    const isPassive = type === "pointerdown" && options?.passive === true;
    nativeListen.call(this, type, listener, isPassive ? { ...options, passive: false } : options);
  };
  const NativeWorker = window.Worker;
  window.Worker = class extends NativeWorker {
    constructor(...args) {
      super(...args);
      let isDrawn = false;
      this.addEventListener("message", ({ data }) => {
        if (data?.type === "connected") {
          isDrawn = false;
          tell("connected");
        } else if (data?.type === "message_batch") {
          colour(data.messages);
          if (isDrawn) return;
          const has = (start) => data.messages.some(({ name }) => name?.startsWith(start));
          isDrawn = has("/live/") || has("/replay/");
          if (isDrawn) tell("drawn");
          else if (has("/ground")) tell("ground");
        } else if (data?.type === "closed") {
          closed();
        }
      });
    }
  };

  // Keys belong to the console: STOP, hold to throw and nudging work wherever the focus is.
  for (const type of ["keydown", "keyup"]) {
    window.addEventListener(
      type,
      (event) => {
        event.stopImmediatePropagation();
        if (window.parent === window) return;
        event.preventDefault();
        const { key, code, shiftKey, ctrlKey, altKey, metaKey, repeat } = event;
        const init = { key, code, shiftKey, ctrlKey, altKey, metaKey, repeat };
        const message = { source: "downrange-viewer", type, init };
        window.parent.postMessage(message, location.origin);
      },
      { capture: true },
    );
  }
  // A finger captures what it touches by itself. The viewer takes every capture for a drag that something
  // else has begun, and would hear no tap: it gets the press without one, and the capture comes back after.
  for (const isFirst of [true, false]) {
    window.addEventListener(
      "pointerdown",
      ({ pointerType, pointerId, target }) => {
        if (pointerType === "mouse" || !(target instanceof Element)) return;
        if (!isFirst) target.setPointerCapture(pointerId);
        else if (target.hasPointerCapture(pointerId)) target.releasePointerCapture(pointerId);
      },
      { capture: isFirst },
    );
  }
  window.addEventListener("pointerup", () => {
    if (window.parent !== window) setTimeout(() => window.parent.focus(), 0);
  });

  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) {
    tell("unsupported", "This browser shows no WebGL 2 graphics.");
    return;
  }
  // Drawn by the processor, a picture takes all of it: a pause after each leaves time for the rest.
  const named = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = String(gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  if (/swiftshader|llvmpipe|software|basic render/i.test(renderer)) {
    const draw = window.requestAnimationFrame.bind(window);
    window.requestAnimationFrame = (callback) => setTimeout(() => draw(callback), 150);
    window.cancelAnimationFrame = clearTimeout.bind(window);
  }
})();
