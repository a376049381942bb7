// The websocket: says who this page is, hands over what comes, and tells the console that somebody is here.

const BEAT_MS = 200, AGAIN_MS = 1000;

export class Link {
  // on: {message(header, rows, picture), opened(), refused(text), lost()}
  constructor(on) {
    this.on = on;
    this.waiting = new Map();
    this.number = 0;
    this.beaten_ms = 0;
    this.got = 0; // messages of this connection: the console sends no more than can be read
    this.came_ms = -Infinity;
    // of this tab, also after it was loaded anew: the lease goes on
    this.key = sessionStorage.getItem("hil.key") || crypto.getRandomValues(new Uint32Array(6)).join("-");
    sessionStorage.setItem("hil.key", this.key);
  }

  open(name, token) {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    this.got = 0;
    socket.onopen = () => {
      socket.send(JSON.stringify({ key: this.key, name, token }));
      this.on.opened();
    };
    socket.onmessage = (event) => this.take(event.data);
    socket.onclose = (event) => {
      this.socket = null;
      for (const done of this.waiting.values()) done({ ok: false, text: "the connection is lost" });
      this.waiting.clear();
      this.on.lost();
      if (event.code !== 4401) setTimeout(() => this.open(name, token), AGAIN_MS);
    };
    this.socket = socket;
  }

  take(data) {
    if (typeof data === "string") {
      const message = JSON.parse(data);
      if (message.refused) this.on.refused(message.refused);
      else this.answered(message);
      return;
    }
    const now = performance.now();
    this.came_ms = now;
    this.got++;
    // answered here and not by a timer: timers of a page in the background hardly run
    if (now - this.beaten_ms > BEAT_MS) {
      this.beaten_ms = now;
      this.send({ do: "beat", got: this.got });
    }
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const size = header.rows * header.columns;
    const rows = new Float32Array(data, 4 + length, size);
    this.on.message(header, rows, new Uint8Array(data, 4 + length + 4 * size));
  }

  answered(message) {
    const done = this.waiting.get(message.answer);
    this.waiting.delete(message.answer);
    if (done) done(message);
  }

  send(message) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  // Ask for something; the answer: {ok, text, ask}
  ask(message) {
    if (!this.socket || this.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ ok: false, text: "no connection" });
    const id = ++this.number;
    return new Promise((done) => {
      this.waiting.set(id, done);
      this.socket.send(JSON.stringify({ ...message, id }));
    });
  }
}
