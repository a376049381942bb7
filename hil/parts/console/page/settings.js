// Settings adjustable during the run: present value, unit, allowed range, and an input for a new value.

const $ = (id) => document.getElementById(id);

export class Settings {
  // controls: sends the requests and asks for confirmations
  constructor(controls) {
    this.controls = controls;
    this.rows = new Map();
    $("settings_open").onclick = () => this.toggle();
    $("settings_close").onclick = () => this.toggle(false);
    $("settings").addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.toggle(false);
    });
  }

  toggle(wanted = $("settings").hidden) {
    $("settings").hidden = !wanted;
    if (wanted) ($("settings").querySelector("input:enabled") || $("settings_close")).focus();
    else $("settings_open").focus();
  }

  show(page, allowed) {
    if (page !== this.page) {
      this.page = page;
      this.list(page.settings);
    }
    if (allowed === this.allowed) return;
    this.allowed = allowed;
    for (const control of $("settinglist").querySelectorAll("input, button")) control.disabled = !allowed;
  }

  list(settings) {
    $("settings_none").hidden = settings.length > 0;
    if ([...this.rows.keys()].join() !== settings.map((setting) => setting.key).join()) {
      this.rows = new Map(settings.map((setting) => [setting.key, this.row(setting)]));
      $("settinglist").replaceChildren(...this.rows.values());
    }
    for (const { key, value } of settings) this.rows.get(key).querySelector("b").textContent = number(value);
  }

  row({ key, unit, range }) {
    const row = document.createElement("tr");
    row.innerHTML = "<th></th><td><b></b></td><td></td><td></td><td><input type=number step=any></td><td><button>Set</button></td>";
    const [name, , units, allowed] = row.children;
    name.textContent = key.replace(/^gnc\./, "").replace(".", " \u203a ");
    name.title = key;
    units.textContent = unit || "-";
    allowed.textContent = range.words;
    const input = row.querySelector("input"), button = row.querySelector("button");
    input.ariaLabel = `new value of ${key}, ${unit}, ${range.words}`;
    input.disabled = button.disabled = !this.allowed;
    const set = () => {
      if (input.value === "") return this.controls.notify(`${key}: enter a new value first`);
      this.controls.ask({ do: "adjust", key, value: Number(input.value) }).then(() => (input.value = ""));
    };
    button.onclick = set;
    input.onkeydown = (event) => {
      if (event.key === "Enter") set();
    };
    return row;
  }
}

// Shortest distinct text: 0.0002, 8.33e-7.
export function number(value) {
  return Math.abs(value) >= 1e-4 || value === 0 ? String(Number(value.toPrecision(6))) : value.toExponential().replace(/(\.\d{3})\d+/, "$1");
}
