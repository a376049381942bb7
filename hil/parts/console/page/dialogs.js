// Dialogs and lists within the page. STOP and HOLD stay usable: a modal dialog would make them inert, and a list that
// the browser opens by itself keeps keys and clicks from the page.

const SHADE_MS = 400; // the second click of a double click presses nothing behind a dialog that has closed
const LINES_MAX = 12;

const shade = document.getElementById("shade");
let hiding = 0;

// Disable everything but STOP, HOLD and the dialog.
function block(on) {
  for (const part of document.querySelectorAll("header, section, main")) part.inert = on;
  clearTimeout(hiding);
  if (on) shade.hidden = false;
  else hiding = setTimeout(() => (shade.hidden = true), SHADE_MS);
}

export function openDialog(dialog) {
  if (dialog.open) return;
  block(true);
  dialog.show();
}

export function closeDialog(dialog) {
  if (!dialog.open) return;
  block(false); // first, so that the focus returns
  dialog.close();
}

// Open the list of a select as lines of the page.
export function openInPage(select) {
  const show = (on) => (on ? (select.size = Math.min(LINES_MAX, Math.max(2, select.options.length))) : select.removeAttribute("size"));
  select.addEventListener("mousedown", (event) => {
    if (select.size) return;
    event.preventDefault();
    select.focus();
    show(true);
  });
  select.addEventListener("click", (event) => event.target !== select && show(false));
  select.addEventListener("blur", () => show(false));
  select.addEventListener("keydown", (event) => {
    const opens = event.key === " " || event.key === "Enter" || event.key === "F4" || (event.altKey && event.key.startsWith("Arrow"));
    if (opens) event.preventDefault();
    if (opens || event.key === "Escape") show(opens && !select.size);
  });
}
