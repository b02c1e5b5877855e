// Marks: one tap for what happens often, a note for the rest. ✔ is shown when the daemon says that it is in the
// log, not before; a refusal stays until the same mark is tried again.

import { t, word } from "./language.js";
import { element, put } from "./tiles.js";

const MARK_BYTES = 1024;
const SHOWN_MS = 8000; // a mark that is in the log
const byId = (id) => document.getElementById(id);

// What the daemon is asked to note in its log: {noted, text}.
export async function noted(path, text) {
  try {
    const answer = await fetch(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ text }) });
    return await answer.json();
  } catch {
    return { noted: false, text: word("the server of this page does not answer") };
  }
}

const told = (result) => (result.noted ? word("✔ Written to the log.") : t`✘ Not in the log: ${result.text}`);

export function prepareMarks() {
  const answers = new Map(); // what was tapped -> what became of it
  const show = () => {
    byId("marks-told").replaceChildren(...[...answers].map(([text, [words, state]]) => {
      const line = element("p", "", `${word(text)}: ${words}`);
      line.dataset.state = state;
      return line;
    }));
  };
  for (const button of document.querySelectorAll("[data-mark]")) {
    button.addEventListener("click", async () => {
      const text = button.dataset.mark;
      button.disabled = true;
      answers.set(text, [word("asking the daemon …"), "wait"]);
      show();
      const result = await noted("/mark", text);
      button.disabled = false;
      const answer = [told(result), result.noted ? "good" : "bad"];
      answers.set(text, answer);
      show();
      if (!result.noted) return;
      setTimeout(() => {
        if (answers.get(text) === answer) answers.delete(text);
        show();
      }, SHOWN_MS);
    });
  }
  prepareNote();
}

function prepareNote() {
  const [dialog, input, answer, button, cancel] = ["mark-dialog", "mark-text", "mark-told", "mark-send", "mark-cancel"].map(byId);
  const open = () => {
    put(answer, "");
    put(cancel, word("Cancel"));
    dialog.showModal();
    input.focus();
  };
  byId("mark").addEventListener("click", open);
  cancel.addEventListener("click", () => dialog.close());
  document.addEventListener("keydown", (event) => {
    const marks = document.querySelector(".marks");
    if (marks.hidden || marks.disabled) return; // of a recorded run, or of a daemon that is gone
    const typing = dialog.open || event.target.closest?.("input, textarea");
    if (event.key.toLowerCase() === "m" && !typing && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      open();
    }
  });
  byId("mark-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const size = new TextEncoder().encode(input.value).length;
    if (size > MARK_BYTES) {
      put(answer, t`✘ This note has ${size} bytes; ${MARK_BYTES} are the most.`);
      return;
    }
    button.disabled = true;
    put(answer, word("Asking the daemon …"));
    const result = await noted("/mark", input.value);
    button.disabled = false;
    put(answer, told(result));
    if (result.noted) {
      input.value = "";
      put(cancel, word("Close"));
      cancel.focus();
    }
  });
}
