// Websocket of the page: authentication, updates, requests and heartbeat.

import { device, proof } from "/page/keys.js";

const BEAT_MS = 200, BEATS = 5, RECONNECT_MS = 1000, LOST_MS = 500, OLD_S = 0.5, DROPPED_MS = 3000, GREETED_MS = 6000;

export class Link {
  // on: {message(header, rows, data), required(what), opened(), refused(text), lost()}; required returns, or promises, who
  // is at this page: {name, token} or {key}, null if it has to be asked
  constructor(on) {
    this.on = on;
    this.waiting = new Map();
    this.number = 0;
    this.beat_ms = 0;
    this.got = 0; // number of received messages: the console sends no more than the page can read
    this.received_ms = -Infinity;
    this.sent = 0; // number of the last request that may move the bench
    this.seen_s = null; // wall_s of the newest update that is drawn: what an operator acts on
    this.beats = []; // round trip, ms, and by how much the console's clock is ahead at most, s, of the last beats
    this.heard_ms = Infinity; // when the newest beat that was answered was sent
    this.ahead_s = null; // the least of these: how much the console's clock is ahead
    this.page = crypto.getRandomValues(new Uint32Array(4)).join("-"); // a new connection of this page replaces a lost one
    setInterval(() => this.drop(), RECONNECT_MS);
    // key of this tab, also after a reload: the lease continues
    this.key = sessionStorage.getItem("hil.key") || crypto.getRandomValues(new Uint32Array(6)).join("-");
    sessionStorage.setItem("hil.key", this.key);
  }

  get connected() {
    return Boolean(this.socket) && this.greeted && this.socket.readyState === WebSocket.OPEN;
  }

  // Whether no message has been received for 0.5 s, or the console has answered no beat of that time: a network may fail
  // silently, in one direction alone.
  get lost() {
    return performance.now() - Math.min(this.received_ms, this.heard_ms + BEAT_MS) > LOST_MS;
  }

  // Whether the values that are drawn are too old to act on.
  get old() {
    return this.lost || this.age_s > OLD_S;
  }

  // The longest round trip of the last beats, ms.
  get round_trip_ms() {
    return this.beats.length ? Math.max(...this.beats.map((beat) => beat.trip_ms)) : Infinity;
  }

  // Age of the values that are drawn, s: since the console sent them, by its beats, and at least since their reception.
  get age_s() {
    const received_s = this.received_ms > 0 ? (performance.now() - this.received_ms) / 1000 : 0;
    return this.ahead_s === null ? received_s : Math.max(received_s, Date.now() / 1000 + this.ahead_s - this.seen_s);
  }

  open() {
    if (this.socket) return;
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    this.got = 0;
    this.sent = 0;
    this.greeted = this.asked = false;
    this.opened_ms = performance.now();
    socket.onmessage = (event) => socket === this.socket && this.receive(event.data);
    socket.onclose = (event) => {
      if (this.socket !== socket) return; // dropped before
      this.socket = null;
      this.forget();
      if (event.code !== 4401 && !this.asked) setTimeout(() => this.open(), RECONNECT_MS);
    };
    this.socket = socket;
  }

  // Drop a connection that has been silent for so long, or on which no challenge came in the time that the console waits
  // for the reply: what it still holds is refused for its age when it arrives.
  drop() {
    const since_ms = performance.now() - Math.max(this.received_ms, this.opened_ms);
    if (!this.socket || since_ms < (this.greeted ? DROPPED_MS : GREETED_MS)) return;
    this.socket.close();
    this.socket = null;
    this.forget();
    this.open();
  }

  // What was asked has no answer any more.
  forget() {
    this.greeted = false;
    for (const done of this.waiting.values()) done({ ok: false, text: "connection lost" });
    this.waiting.clear();
    this.beats = [];
    this.heard_ms = Infinity;
    this.on.lost();
  }

  // Answer the challenge; if the operator has to be asked first, close the connection until open() is called again.
  async greet({ challenge, required }) {
    const socket = this.socket, who = await this.on.required(required);
    if (socket !== this.socket) return;
    if (!who) return this.close();
    const proved = who.key ? await proof(who.key, challenge, this.key) : who;
    socket.send(JSON.stringify({ key: this.key, page: this.page, device: device(), ...proved }));
    this.greeted = true;
    this.on.opened();
  }

  close() {
    this.asked = true;
    if (this.socket) this.socket.close();
    this.socket = null;
  }

  receive(data) {
    if (typeof data === "string") {
      const message = JSON.parse(data);
      if (message.challenge) this.greet(message);
      else if (message.beat) this.beaten(message);
      else if (message.refused) this.on.refused(message.refused);
      else this.answered(message);
      return;
    }
    const now = performance.now();
    this.received_ms = now;
    this.got++;
    // sent here and not by a timer: timers of a background page are throttled
    if (now - this.beat_ms > BEAT_MS) {
      this.beat_ms = now;
      if (this.heard_ms === Infinity) this.heard_ms = now; // the first
      this.socket.send(JSON.stringify({ do: "beat", got: this.got, sent_ms: now }));
    }
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const size = header.rows * header.columns;
    const rows = new Float32Array(data, 4 + length, size);
    this.on.message(header, rows, new Uint8Array(data, 4 + length + 4 * size));
  }

  beaten({ beat, wall_s }) {
    this.heard_ms = beat;
    const trip_ms = performance.now() - beat;
    this.beats = [...this.beats.slice(1 - BEATS), { trip_ms, ahead_s: wall_s - (Date.now() - trip_ms) / 1000 }];
    this.ahead_s = Math.min(...this.beats.map((each) => each.ahead_s));
  }

  answered(message) {
    const done = this.waiting.get(message.answer);
    this.waiting.delete(message.answer);
    if (done) done(message);
  }

  send(message) {
    if (this.connected) this.socket.send(JSON.stringify({ ...message, seen_s: this.seen_s, number: ++this.sent }));
  }

  // Send a request; the answer: {ok, text, ask}
  ask(message) {
    if (!this.connected) return Promise.resolve({ ok: false, text: "no connection" });
    const id = ++this.number;
    return new Promise((done) => {
      this.waiting.set(id, done);
      this.send({ ...message, id });
    });
  }
}
