// In the page of `curlfit app`, which cannot look into this one: it is told how high this
// page is, and where a link within it leads, since the frame itself does not scroll.
if (parent !== window) {
  const tell = (what) => parent.postMessage(what, "*");
  const tellHeight = () => tell({height: document.body.offsetHeight});
  tellHeight(); // an observer waits until the frame is on the screen
  new ResizeObserver(tellHeight).observe(document.body);
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    const target = link && document.getElementById(link.hash.slice(1));
    if (target) tell({top: target.getBoundingClientRect().top});
  });
}
