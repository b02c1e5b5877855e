// The page's own words: English, or German by the browser's language or the switch. Sentences of the daemon have
// their German beside them, in a field `…_de`.

import { GERMAN } from "./german.js";

const KEPT = "tilth-language";
const NAMED = ["aria-label", "title"]; // attributes that people read or hear
const stored = () => {
  try {
    return localStorage.getItem(KEPT);
  } catch {
    return null; // a browser that keeps nothing
  }
};
export const language = stored() ?? (navigator.language.startsWith("de") ? "de" : "en");
const german = language === "de";

// A whole text, if it has words of its own.
export const word = (text) => (german ? GERMAN[text] ?? text : text);

// t`${n} of 4 receivers`: the row of GERMAN is "{} of 4 receivers".
export function t(parts, ...values) {
  const [first, ...rest] = word(parts.join("{}")).split("{}");
  return rest.reduce((text, part, i) => text + String(values[i]) + part, first);
}

// What a message says, in this language where it has it.
export const said = (message, key) => (german ? message[`${key}_de`] || message[key] : message[key]);

export function translatePage() {
  document.documentElement.lang = language;
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const { data } = texts.currentNode, text = data.trim();
    if (text && word(text) !== text) texts.currentNode.data = data.replace(text, () => word(text));
  }
  for (const name of NAMED) {
    for (const one of document.querySelectorAll(`[${name}]`)) one.setAttribute(name, word(one.getAttribute(name)));
  }
}

export function prepareSwitch(button) {
  button.textContent = german ? "EN" : "DE";
  button.addEventListener("click", () => {
    try {
      localStorage.setItem(KEPT, german ? "en" : "de");
    } catch {
      return;
    }
    location.reload();
  });
}
