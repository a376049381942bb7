// Key of the operator at this page: kept by the browser in a form that no script can read out, and proved to the console.

const KEPT = "key", PROOF = "hil operator key 1";
const FILE = /^name = "(.+)"\s*\nsecret = "([0-9a-f]{64})"\s*$/;

const hex = (bytes) => [...new Uint8Array(bytes)].map((byte) => byte.toString(16).padStart(2, "0")).join("");

// The same in all tabs of this browser, so that a copy of the key elsewhere is found.
export function device() {
  const known = localStorage.getItem("hil.device") || hex(crypto.getRandomValues(new Uint8Array(16)));
  localStorage.setItem("hil.device", known);
  return known;
}

function store(work) {
  return new Promise((done, failed) => {
    const request = indexedDB.open("hil", 1);
    request.onupgradeneeded = () => request.result.createObjectStore("keys");
    request.onerror = () => failed(request.error);
    request.onsuccess = () => {
      const action = work(request.result.transaction("keys", "readwrite").objectStore("keys"));
      action.onsuccess = () => done(action.result);
      action.onerror = () => failed(action.error);
    };
  });
}

export const keptKey = () => store((keys) => keys.get(KEPT));
export const forgetKey = () => store((keys) => keys.delete(KEPT));

// Keep the key in the text of an operator's file; throw an Error with the reason if it is none.
export async function keepKey(text) {
  const found = FILE.exec(text);
  if (!found) throw new Error("not the key file of an operator, as hil operators add writes it");
  if (!crypto.subtle) throw new Error("this browser handles keys with https only, or on the console's own computer");
  const secret = Uint8Array.from(found[2].match(/../g), (pair) => parseInt(pair, 16));
  const id = hex(await crypto.subtle.digest("SHA-256", secret)).slice(0, 16);
  const key = await crypto.subtle.importKey("raw", secret, { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  await store((keys) => keys.put({ name: found[1], id, key }, KEPT));
}

// The first message to a console that requires a key: `page` is the secret of this tab.
export async function proof({ id, key }, challenge, page) {
  const text = new TextEncoder().encode([PROOF, location.host, challenge, page].join("\n"));
  return { operator: id, proof: hex(await crypto.subtle.sign("HMAC", key, text)) };
}
