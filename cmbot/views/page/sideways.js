// Tables that are wider than their place say so: on phones nothing else shows that they scroll.
function markSideways() {
  for (const box of document.querySelectorAll(".table, .wide, #joint-grid")) {
    box.classList.toggle("sideways", box.scrollWidth > box.clientWidth + 1);
  }
}
new ResizeObserver(markSideways).observe(document.body);
