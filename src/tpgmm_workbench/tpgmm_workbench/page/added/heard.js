// SPDX-License-Identifier: Apache-2.0
// What is pressed is done, or answered in words. The page's library drops keys and clicks without a word as long as the
// connection is being made, and where it is lost; and keys while a box has the focus, Esc for STOP among them.
(() => {
  const MARK = "tpgmm-heard"; // the server shows it on this page as soon as it hears it
  const CONNECTING = "connecting: what you press is not heard yet";
  const LOST =
    "no connection to the workbench: nothing that you press here is heard, and STOP neither. " +
    "Stop the robot by its own switch.";
  const ANOTHER_TOKEN = " The workbench was started again, and has another token: open the address that it printed.";
  const LOOK_MS = 200;
  // the library tries once per second, and drops a trial that takes longer: on a busy machine it never comes back
  const RELOAD_MS = 5000;

  const notice = document.createElement("div");
  notice.id = "tpgmm-notice";
  notice.setAttribute("role", "alert");
  // a small window has no place for the panel with STOP, and a user may fold it away: then there is this one
  const stop = document.createElement("button");
  stop.id = "tpgmm-stop";
  stop.textContent = "STOP";
  stop.hidden = true;
  let wasHeard = false;
  let isFrozen = false;
  let unheard = "";
  let lostSince = 0;
  let isAsking = false;
  let isRefused = false;

  function stopOfPanel() {
    return [...document.querySelectorAll("button")].find((one) => one !== stop && one.textContent.includes("STOP"));
  }

  /** Whether the server hears this page: its mark is there, and the library lets it be clicked.
   * A panel that is folded away has no mark; then STOP counts, and without both, what was so before. */
  function isHeard() {
    const mark = document.getElementById(MARK);
    const shown = mark ?? stopOfPanel();
    if (!shown) return wasHeard && !isFrozen;
    isFrozen = getComputedStyle(shown).pointerEvents === "none";
    return !isFrozen && (mark !== null || wasHeard);
  }

  function look() {
    const heard = isHeard();
    wasHeard ||= heard;
    if (heard) unheard = "";
    const state = wasHeard ? LOST + (isRefused ? ANOTHER_TOKEN : "") : CONNECTING;
    const words = heard ? "" : state + (unheard && ` ${unheard} was not heard: press it again then.`);
    if (notice.textContent !== words) notice.textContent = words;
    notice.hidden = heard;
    stop.hidden = (stopOfPanel()?.getBoundingClientRect().height ?? 0) > 0;
    if (!notice.isConnected && document.body) document.body.append(notice, stop);
  }

  /** Load the page anew where it was heard before, is not for a while, and its server answers again. */
  function comeBack() {
    if (!wasHeard || isHeard()) {
      lostSince = 0;
      isRefused = false;
      return;
    }
    lostSince ||= Date.now();
    if (isAsking || Date.now() - lostSince < RELOAD_MS) return;
    isAsking = true;
    fetch(location.href, { cache: "no-store" })
      .then((answer) => {
        isRefused = answer.status === 403;
        if (answer.ok && !isHeard()) location.reload();
      })
      .catch(() => {}) // nobody answers yet
      .finally(() => (isAsking = false));
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
    press(event.key, event.code);
  }

  function press(key, code) {
    document.body.dispatchEvent(new KeyboardEvent("keydown", { key, code, bubbles: true }));
  }

  function onPress(event) {
    if (isHeard()) return;
    const button = [...document.querySelectorAll("button")].find((one) => {
      const box = one.getBoundingClientRect();
      return event.clientX >= box.left && event.clientX <= box.right && event.clientY >= box.top && event.clientY <= box.bottom;
    });
    if (button?.textContent) missed(`“${button.textContent.trim()}”`);
  }

  stop.addEventListener("click", () => press("Escape", "Escape"));
  window.addEventListener("keydown", onKey, true);
  window.addEventListener("pointerdown", onPress, true);
  setInterval(look, LOOK_MS);
  setInterval(comeBack, LOOK_MS);
})();
