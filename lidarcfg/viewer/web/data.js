// The page's data: from its server, or from scripts inside a standalone file.

const inside = document.getElementById("about");

export async function readAbout() {
  return inside ? JSON.parse(inside.textContent) : (await fetched("about.json")).json();
}

export async function readArray(name, Kind) {
  if (!inside) return new Kind(await (await fetched(`array/${name}`)).arrayBuffer());
  const pieces = [...document.querySelectorAll(`script[data-array="${name}"]`)].map((script) => {
    const piece = bytes(script.textContent);
    script.remove();
    return piece;
  });
  return new Kind(await new Blob(pieces).arrayBuffer());
}

export const unpacked = (text, Kind) => new Kind(bytes(text).buffer);

function bytes(text) {
  return Uint8Array.fromBase64?.(text) ?? Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

// The token proves that it is the served page that asks, where something is written.
export function ask(path, question, token) {
  const headers = token ? { "X-Lidarcfg-Token": token } : {};
  return fetched(path, { method: "POST", body: JSON.stringify(question), headers });
}

async function fetched(path, options) {
  const answer = await fetch(path, options);
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer;
}
