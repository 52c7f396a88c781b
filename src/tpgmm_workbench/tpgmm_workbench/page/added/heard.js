// SPDX-License-Identifier: Apache-2.0
// What is pressed is done, or answered in words. The page's library drops keys and clicks without a word as long as the
// connection is being made, and where it is lost; and keys while a box has the focus, Esc for STOP among them.
(() => {
  const MARK = "tpgmm-heard"; // the server shows it on this page as soon as it hears it
  const CONNECTING = "connecting: what you press is not heard yet";
  const LOST =
    "no connection to the workbench: nothing that you press here is heard, and STOP neither. " +
    "Stop the robot by its own switch.";
  const LOOK_MS = 200;

  const notice = document.createElement("div");
  notice.id = "tpgmm-notice";
  notice.setAttribute("role", "alert");
  let wasHeard = false;
  let unheard = "";

  /** Whether the server hears this page: its mark is there, and the library lets it be clicked. */
  function isHeard() {
    const mark = document.getElementById(MARK);
    return mark !== null && getComputedStyle(mark).pointerEvents !== "none";
  }

  function look() {
    const heard = isHeard();
    wasHeard ||= heard;
    if (heard) unheard = "";
    const state = wasHeard ? LOST : CONNECTING;
    const words = heard ? "" : state + (unheard && ` ${unheard} was not heard: press it again then.`);
    if (notice.textContent !== words) notice.textContent = words;
    notice.hidden = heard;
    if (!notice.isConnected && document.body) document.body.append(notice);
  }

  function missed(what) {
    if (isHeard()) return;
    unheard = what;
    look();
  }

  /** Whether letters that come to an element are a text that is written. */
  function isText(element) {
    if (element instanceof HTMLTextAreaElement) return true;
    if (!(element instanceof HTMLInputElement) || element.readOnly) return false;
    return ["text", "search"].includes(element.type) && !["decimal", "numeric"].includes(element.inputMode);
  }

  function onKey(event) {
    const isLetter = event.key.length === 1 && /\p{L}/u.test(event.key);
    const isStop = event.key === "Escape";
    const { target } = event;
    if (!event.isTrusted || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    if (!(isStop || isLetter || event.key === " ") || (isText(target) && !isStop)) return;
    missed(`The key ${event.key === " " ? "space" : event.key.toUpperCase()}`);
    if (event.key === " " || !["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName)) return;
    if (isLetter) event.preventDefault(); // a box of numbers would show it
    document.body.dispatchEvent(new KeyboardEvent("keydown", { key: event.key, code: event.code, bubbles: true }));
  }

  function onPress(event) {
    if (isHeard()) return;
    const button = [...document.querySelectorAll("button")].find((one) => {
      const box = one.getBoundingClientRect();
      return event.clientX >= box.left && event.clientX <= box.right && event.clientY >= box.top && event.clientY <= box.bottom;
    });
    if (button?.textContent) missed(`“${button.textContent.trim()}”`);
  }

  window.addEventListener("keydown", onKey, true);
  window.addEventListener("pointerdown", onPress, true);
  setInterval(look, LOOK_MS);
})();
