// What both halves of the page need: an element, a question to the server, and its trouble shown.
const MARK = { "X-ffcomp": "1" };

/** An element with properties and children; text is only ever text. */
export function make(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** Ask the server; a refusal is an Error with its sentence. */
export async function ask(path, asked) {
  const options = asked === undefined ? {} : { method: "POST", headers: { ...MARK, "Content-Type": "application/json" }, body: JSON.stringify(asked) };
  const answer = await fetch(path, options);
  if (!answer.ok) throw new Error(await sentence(answer));
  return answer.json();
}

async function sentence(answer) {
  const text = await answer.text();
  try { return JSON.parse(text).error; } catch { return text || `The server answered ${answer.status}.`; }
}

/** Do something, and show its trouble. */
export async function attempt(what) {
  const trouble = document.querySelector("#trouble");
  trouble.hidden = true;
  try { return await what(); } catch (error) {
    trouble.textContent = error.message === "Failed to fetch" ? "The server does not answer: is it still running?" : error.message;
    trouble.hidden = false;
    return undefined;
  }
}
