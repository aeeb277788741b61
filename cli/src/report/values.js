// Values under the pointer. Everything else on this page works without it.
"use strict";
(() => {
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  document.body.append(tip);
  const short = (value) => String(Number(value.toPrecision(3))).replace("-", "−");
  const at = (value, from0, from1, to0, to1) => to0 + ((value - from0) / (from1 - from0)) * (to1 - to0);

  for (const chart of document.querySelectorAll("g.chart")) {
    const svg = chart.ownerSVGElement;
    const [low, high, left, right, bottomValue, topValue, bottom, top] = chart.dataset.axes.split(" ").map(Number);
    const curves = [...chart.querySelectorAll("g.curve")].map((curve) => ({
      label: curve.dataset.label,
      colour: getComputedStyle(curve).getPropertyValue("--c"),
      points: (curve.querySelector("polyline").getAttribute("points") || "").split(" ").filter(Boolean).map((p) => p.split(",").map(Number)),
    })).filter((curve) => curve.points.length);
    if (!curves.length) continue;
    const cursor = document.createElementNS(svg.namespaceURI, "line");
    cursor.setAttribute("class", "cursor");
    cursor.setAttribute("y1", top);
    cursor.setAttribute("y2", bottom);
    cursor.style.display = "none";
    chart.append(cursor);

    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      const x = (event.clientX - box.left) * (svg.viewBox.baseVal.width / box.width);
      if (x < left - 4 || x > right + 4) return hide();
      const nearest = (points) => points.reduce((best, p) => (Math.abs(p[0] - x) < Math.abs(best[0] - x) ? p : best));
      const found = curves.map((curve) => ({ ...curve, point: nearest(curve.points) }));
      const snapped = found[0].point[0];
      const over = at(snapped, left, right, low, high);
      cursor.style.display = "";
      cursor.setAttribute("x1", snapped);
      cursor.setAttribute("x2", snapped);
      const head = document.createElement("strong");
      head.textContent = chart.dataset.over === "time" ? short(over / 60) + " min" : "update " + Math.round(over);
      tip.replaceChildren(head, ...found.map((curve) => {
        const line = document.createElement("div");
        const key = document.createElement("span");
        key.className = "key";
        key.style.setProperty("--c", curve.colour);
        line.append(key, (curve.label ? curve.label + " " : "") + short(at(curve.point[1], bottom, top, bottomValue, topValue)));
        return line;
      }));
      tip.hidden = false;
      const { width, height } = tip.getBoundingClientRect();
      const rightward = event.clientX + 16 + width < document.documentElement.clientWidth;
      tip.style.left = (rightward ? event.clientX + 16 : event.clientX - 16 - width) + "px";
      tip.style.top = Math.max(4, event.clientY - height - 8) + "px";
    });
    const hide = () => {
      tip.hidden = true;
      cursor.style.display = "none";
    };
    svg.addEventListener("pointerleave", hide);
  }
})();
