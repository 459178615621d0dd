// What the page is told: by its server, or by the scripts that a standalone file carries.

const inside = document.getElementById("about");

export async function readAbout() {
  return inside ? JSON.parse(inside.textContent) : (await answered("about.json")).json();
}

export async function readArray(name, Kind) {
  if (!inside) return new Kind(await (await answered(`array/${name}`)).arrayBuffer());
  const pieces = [];
  for (const script of document.querySelectorAll(`script[data-array="${name}"]`)) {
    const packed = await fetch(`data:application/octet-stream;base64,${script.textContent}`);
    script.remove();
    pieces.push(await new Response(packed.body.pipeThrough(new DecompressionStream("gzip"))).arrayBuffer());
  }
  const whole = new Uint8Array(pieces.reduce((total, piece) => total + piece.byteLength, 0));
  let at = 0;
  for (const piece of pieces) {
    whole.set(new Uint8Array(piece), at);
    at += piece.byteLength;
  }
  return new Kind(whole.buffer);
}

export function unpacked(text, Kind) {
  return new Kind(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

export const ask = (path, question) => answered(path, { method: "POST", body: JSON.stringify(question) });

async function answered(path, options) {
  const answer = await fetch(path, options);
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer;
}
