// The two tracks in a view that is turned by dragging. Orthographic: lengths can be compared.
(() => {
  const view = document.getElementById('view');
  if (!view) return;
  const data = JSON.parse(document.getElementById('tracks').textContent);
  const canvas = document.createElement('canvas');
  const context = canvas.getContext && canvas.getContext('2d');
  if (!context) return;
  canvas.setAttribute('aria-label', 'Both tracks; drag to turn, wheel or pinch to zoom');
  canvas.tabIndex = 0;
  view.append(canvas);
  view.classList.add('live');
  for (const name of ['a', 'b', 'jumps']) {
    const points = data[name];
    for (let k = 3; k < points.length; k += 1) points[k] += points[k - 3];
  }
  const start = { yaw: -0.6, pitch: 0.9, zoom: 1, x: 0, y: 0 };
  let camera = { ...start };
  const tools = document.createElement('div');
  tools.className = 'tools';
  const views = {
    '3-D': start,
    Top: { yaw: 0, pitch: Math.PI / 2, zoom: 1, x: 0, y: 0 },
    Front: { yaw: 0, pitch: 0, zoom: 1, x: 0, y: 0 },
    Side: { yaw: Math.PI / 2, pitch: 0, zoom: 1, x: 0, y: 0 },
  };
  for (const [name, to] of Object.entries(views)) {
    const button = document.createElement('button');
    button.type = 'button';
    button.textContent = name;
    button.addEventListener('click', () => { camera = { ...to }; fit(); draw(); });
    tools.append(button);
  }
  view.append(tools);

  function axes() {
    const { yaw, pitch } = camera;
    const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
    // Rows: to the right, up; world z is up where pitch is 0.
    return [[cy, sy, 0], [-sy * sp, cy * sp, cp]];
  }
  function project(points) {
    const [right, up] = axes();
    const out = new Float64Array(points.length / 3 * 2);
    for (let k = 0, n = 0; k < points.length; k += 3, n += 2) {
      const x = points[k], y = points[k + 1], z = points[k + 2];
      out[n] = right[0] * x + right[1] * y + right[2] * z;
      out[n + 1] = -(up[0] * x + up[1] * y + up[2] * z);
    }
    return out;
  }
  let base = { scale: 1, x: 0, y: 0 };
  function fit() {
    let box = [Infinity, Infinity, -Infinity, -Infinity];
    for (const points of [data.a, data.b]) {
      const flat = project(points);
      for (let n = 0; n < flat.length; n += 2) {
        box = [Math.min(box[0], flat[n]), Math.min(box[1], flat[n + 1]),
          Math.max(box[2], flat[n]), Math.max(box[3], flat[n + 1])];
      }
    }
    const width = canvas.clientWidth - 56, height = canvas.clientHeight - 96;
    base = {
      scale: Math.min(width / Math.max(box[2] - box[0], 1), height / Math.max(box[3] - box[1], 1)),
      x: (box[0] + box[2]) / 2, y: (box[1] + box[3]) / 2,
    };
  }
  function round(value) {
    const power = 10 ** Math.floor(Math.log10(value));
    return power * [5, 2, 1].find((factor) => factor * power <= value);
  }
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio)
        || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    const scale = base.scale * camera.zoom;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.lineJoin = 'round';
    const place = (flat, n) => [(flat[n] - base.x) * scale + width / 2 + camera.x,
      (flat[n + 1] - base.y) * scale + height / 2 + 12 + camera.y];
    const gaps = new Set(data.gaps);
    for (const [points, name, thick, alpha] of [[data.b, '--b', 3, 0.6], [data.a, '--a', 1.4, 1]]) {
      const flat = project(points);
      context.strokeStyle = colour(name);
      context.lineWidth = thick;
      context.globalAlpha = alpha;
      for (const dashed of [false, true]) {
        context.setLineDash(dashed ? [4, 5] : []);
        context.beginPath();
        let pen = false;
        for (let k = 0; k + 1 < flat.length / 2; k += 1) {
          if (gaps.has(k) !== dashed) { pen = false; continue; }
          if (!pen) context.moveTo(...place(flat, 2 * k));
          context.lineTo(...place(flat, 2 * k + 2));
          pen = true;
        }
        context.stroke();
      }
    }
    context.globalAlpha = 1;
    context.setLineDash([]);
    context.fillStyle = colour('--jump');
    const jumps = project(data.jumps);
    for (let n = 0; n < jumps.length; n += 2) {
      const [x, y] = place(jumps, n);
      context.beginPath();
      context.arc(x, y, 3.2, 0, 7);
      context.fill();
    }
    const first = project(data.a.slice(0, 3));
    const [x, y] = place(first, 0);
    context.beginPath();
    context.arc(x, y, 4.5, 0, 7);
    context.fillStyle = colour('--card');
    context.fill();
    context.strokeStyle = colour('--ink');
    context.lineWidth = 1.5;
    context.stroke();
    context.font = '12px system-ui, sans-serif';
    context.fillStyle = colour('--ink');
    context.fillText('start', x + 8, y - 6);
    // A scale bar, and the axes of the world of a.
    const metres = data.size / data.grid / scale;
    const bar = round(metres * width / 5);
    context.strokeStyle = colour('--soft');
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(12, height - 16);
    context.lineTo(12, height - 11);
    context.lineTo(12 + bar / metres, height - 11);
    context.lineTo(12 + bar / metres, height - 16);
    context.stroke();
    context.fillText(bar >= 1 ? `${bar} m` : `${Math.round(bar * 1e4) / 10} mm`, 16, height - 18);
    const [right, up] = axes();
    data.axes.forEach((axis, k) => {
      const dx = 24 * right[k], dy = -24 * up[k];
      if (Math.hypot(dx, dy) < 4) return;
      const ox = width - 44, oy = height - 40;
      context.strokeStyle = colour(`--${axis.slice(-1)}`);
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(ox, oy);
      context.lineTo(ox + dx, oy + dy);
      context.stroke();
      context.fillStyle = colour('--soft');
      context.fillText(axis, ox + dx * 1.35 - 3, oy + dy * 1.35 + 4);
    });
  }
  const pointers = new Map();
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener('pointermove', (event) => {
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
      camera.yaw -= dx * 0.008;
      camera.pitch = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.pitch + dy * 0.008));
    }
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    draw();
  });
  for (const name of ['pointerup', 'pointercancel']) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  function zoom(factor) {
    const next = Math.min(200, Math.max(0.3, camera.zoom * factor));
    camera.x *= next / camera.zoom;
    camera.y *= next / camera.zoom;
    camera.zoom = next;
  }
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015));
    draw();
  }, { passive: false });
  canvas.addEventListener('keydown', (event) => {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1],
      ArrowDown: [0, -0.1] }[event.key];
    if (step) {
      camera.yaw += step[0];
      camera.pitch = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.pitch + step[1]));
    } else if (event.key === '+' || event.key === '-') {
      zoom(event.key === '+' ? 1.2 : 1 / 1.2);
    } else {
      return;
    }
    event.preventDefault();
    draw();
  });
  const refresh = () => { fit(); draw(); };
  window.addEventListener('resize', refresh);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', draw);
  refresh();
})();
