// Turns the drawing of the two tracks by dragging. Orthographic: lengths can be compared.
(() => {
  const view = document.getElementById('view');
  if (!view) return;
  const data = JSON.parse(document.getElementById('tracks').textContent);
  const svg = view.querySelector('svg');
  svg.setAttribute('aria-label', 'Both tracks; drag to turn, wheel or pinch to zoom');
  svg.tabIndex = 0;
  const { a, b, jumps } = data, gaps = new Set(data.gaps);
  const views = {
    '3-D': [-0.6, 0.9], Top: [0, Math.PI / 2], Front: [0, 0], Side: [Math.PI / 2, 0],
  };
  let camera, base;
  const tools = document.createElement('div');
  tools.className = 'tools';
  for (const [name, [yaw, pitch]] of Object.entries(views)) {
    const button = document.createElement('button');
    button.type = 'button';
    button.textContent = name;
    button.addEventListener('click', () => {
      camera = { yaw, pitch, zoom: 1, x: 0, y: 0 };
      refresh();
    });
    tools.append(button);
  }
  view.append(tools);

  // To the right and down; world z is up where pitch is 0.
  function turned([x, y, z]) {
    const cy = Math.cos(camera.yaw), sy = Math.sin(camera.yaw);
    const cp = Math.cos(camera.pitch), sp = Math.sin(camera.pitch);
    return [cy * x + sy * y, sy * sp * x - cy * sp * y - cp * z];
  }
  function refresh() {
    const flat = [...a, ...b].map(turned);
    const [left, right] = [Math.min, Math.max].map((f) => f(...flat.map((point) => point[0])));
    const [top, bottom] = [Math.min, Math.max].map((f) => f(...flat.map((point) => point[1])));
    base = {
      scale: Math.min((svg.clientWidth - 56) / Math.max(right - left, 1e-6),
        (svg.clientHeight - 96) / Math.max(bottom - top, 1e-6)),
      x: (left + right) / 2, y: (top + bottom) / 2,
    };
    draw();
  }
  function draw() {
    const width = svg.clientWidth, height = svg.clientHeight;
    const scale = base.scale * camera.zoom;
    const place = (point) => {
      const [x, y] = turned(point);
      return [((x - base.x) * scale + width / 2 + camera.x).toFixed(1),
        ((y - base.y) * scale + height / 2 + 12 + camera.y).toFixed(1)];
    };
    const path = (style, d) => `<path class="${style}" d="${d || 'M0 0'}"/>`;
    const text = (x, y, words) => `<text class="note" x="${x}" y="${y}">${words}</text>`;
    const dot = (style, [x, y], r) => `<circle class="${style}" cx="${x}" cy="${y}" r="${r}"/>`;
    const track = (style, points) => {
      const at = points.map(place), d = ['', ''];
      for (let k = 0; k + 1 < at.length; k += 1) {
        const pen = k > 0 && gaps.has(k) === gaps.has(k - 1);
        d[Number(gaps.has(k))] += `${pen ? '' : `M${at[k]}`}L${at[k + 1]}`;
      }
      return path(style, d[0]) + path(`${style} dashed`, d[1]);
    };
    const start = place(a[0]);
    // A scale bar, and the axes of the world of a.
    const longest = width / 5 / scale, power = 10 ** Math.floor(Math.log10(longest));
    const bar = power * [5, 2, 1].find((factor) => factor * power <= longest);
    const [ox, oy] = [width - 44, height - 40];
    svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
    svg.innerHTML = track('line-b wide', b) + track('line-a', a)
      + jumps.map((point) => dot('jump', place(point), 3.4)).join('')
      + dot('start', start, 5) + text(Number(start[0]) + 8, Number(start[1]) - 6, 'start')
      + path('axis', `M12 ${height - 16}v5h${bar * scale}v-5`)
      + text(16, height - 18, bar >= 1 ? `${bar} m` : `${Math.round(bar * 1e4) / 10} mm`)
      + data.axes.map((axis, k) => {
        const [x, y] = turned([0, 1, 2].map((n) => 24 * (n === k)));
        return Math.hypot(x, y) < 4 ? '' : path(`axis-${axis.slice(-1)}`, `M${ox} ${oy}l${x} ${y}`)
          + text(ox + x * 1.35 - 3, oy + y * 1.35 + 4, axis);
      }).join('');
  }
  function turn(yaw, pitch) {
    camera.yaw += yaw;
    camera.pitch = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.pitch + pitch));
  }
  function zoom(factor) {
    const next = Math.min(200, Math.max(0.3, camera.zoom * factor));
    camera.x *= next / camera.zoom;
    camera.y *= next / camera.zoom;
    camera.zoom = next;
  }
  const pointers = new Map();
  svg.addEventListener('pointerdown', (event) => {
    svg.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  svg.addEventListener('pointermove', (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before[0], dy = event.clientY - before[1];
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]);
      const is = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
      zoom(is / Math.max(was, 1));
    } else if (event.shiftKey || event.buttons === 4) {
      camera.x += dx;
      camera.y += dy;
    } else {
      turn(-0.008 * dx, 0.008 * dy);
    }
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    draw();
  });
  for (const name of ['pointerup', 'pointercancel']) {
    svg.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  svg.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015));
    draw();
  }, { passive: false });
  svg.addEventListener('keydown', (event) => {
    const keys = {
      ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0),
      ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
      '+': () => zoom(1.2), '-': () => zoom(1 / 1.2),
    };
    if (!keys[event.key]) return;
    keys[event.key]();
    event.preventDefault();
    draw();
  });
  window.addEventListener('resize', refresh);
  tools.firstChild.click();
})();
