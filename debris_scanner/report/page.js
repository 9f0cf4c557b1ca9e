'use strict';
(() => {
  const root = document.documentElement;
  const dark = window.matchMedia('(prefers-color-scheme: dark)');
  const touch = window.matchMedia('(pointer: coarse)').matches;
  // Named one by one: left to itself, the library adds a button that sends the figure to its maker's server.
  const flat = ['zoom2d', 'pan2d', 'resetScale2d', 'toImage'];
  const deep = ['orbitRotation', 'zoom3d', 'pan3d', 'resetCameraDefault3d', 'toImage'];
  const options = { displaylogo: false, responsive: true, plotlyServerURL: '', doubleClickDelay: 400 };
  root.dataset.theme = dark.matches ? 'dark' : 'light';

  // A figure's colours are names of this page's CSS variables.
  function themed(key) {
    const style = getComputedStyle(root);
    const source = document.querySelector(`script[data-for="${key}"]`).textContent;
    const figure = JSON.parse(source.replace(/var\((--\w+)\)/g, (_, name) => style.getPropertyValue(name).trim()));
    for (const trace of figure.data) {
      if (!trace.meta?.half) continue;
      const { size, steps, half } = trace.meta;
      const values = bytesOf(half);
      trace.z = Array.from({ length: size }, () => new Float32Array(size));
      for (let row = 0, k = 0; row < size; row++) {
        for (let column = 0; column <= row; column++) trace.z[row][column] = trace.z[column][row] = values[k++] / steps;
      }
    }
    figure.layout.font.family = getComputedStyle(document.body).fontFamily;
    figure.layout.uirevision = 'kept'; // zoom and camera survive a change of theme
    figure.layout.autosize = true;
    figure.layout.modebar = {
      bgcolor: 'rgba(0,0,0,0)', color: style.getPropertyValue('--muted'), activecolor: style.getPropertyValue('--accent'),
    };
    // one finger scrolls the page, except on what can be turned
    if (touch && !figure.layout.scene) figure.layout.dragmode = false;
    return figure;
  }

  function shown(div) {
    const pressed = div.closest('figure').querySelector('.choices [aria-pressed="true"]');
    return pressed && JSON.parse(pressed.dataset.visible);
  }

  async function draw(div) {
    try {
      const figure = themed(div.id);
      const visible = shown(div);
      if (visible) figure.data.forEach((trace, k) => { trace.visible = visible.includes(k); });
      const buttons = figure.layout.scene ? deep : flat;
      const config = { ...options, modeBarButtons: [buttons], displayModeBar: touch ? false : 'hover' };
      await Plotly.react(div, figure.data, figure.layout, config);
      if (div.id === 'pairs' && div.dataset.row) selectRow(Number(div.dataset.row));
    } catch (error) {
      div.classList.add('failed');
      div.textContent = `This figure cannot be drawn: ${error.message}`;
      console.error(error);
    }
  }

  // The library travels compressed; unpacked it is a script like any other.
  async function unpackLibrary() {
    const unpacked = new Blob([bytesOf(document.getElementById('library').textContent)]).stream().pipeThrough(new DecompressionStream('gzip'));
    const script = document.createElement('script');
    script.textContent = await new Response(unpacked).text();
    document.head.append(script);
  }

  async function drawAll() {
    for (const div of document.querySelectorAll('.plot')) {
      await draw(div);
      await new Promise((resume) => setTimeout(resume)); // the page stays responsive meanwhile
    }
    root.dataset.ready = 'yes';
  }

  for (const button of document.querySelectorAll('.choices button')) {
    button.addEventListener('click', () => {
      const div = button.closest('figure').querySelector('.plot');
      for (const other of button.parentElement.children) other.setAttribute('aria-pressed', other === button);
      const visible = JSON.parse(button.dataset.visible);
      Plotly.restyle(div, { visible: div.data.map((_, k) => visible.includes(k)) });
    });
  }

  const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

  function numbers(array) {
    if (!array.bdata) return Array.from(array);
    const Kind = array.dtype === 'f4' ? Float32Array : Float64Array;
    return Array.from(new Kind(bytesOf(array.bdata).buffer));
  }

  // A click into the map of pairs shows that key frame's row in the plot above it.
  function selectRow(row) {
    const pairs = document.getElementById('pairs');
    const lines = document.getElementById('likeness');
    const times = numbers(lines.data[0].x);
    if (row < 0 || row >= times.length) return;
    pairs.dataset.row = row;
    const rows = pairs.data.filter((t) => t.type === 'heatmap').map((t) => Array.from(t.z[row]));
    Plotly.update(lines, { y: rows }, {
      'shapes[0].x0': times[row], 'shapes[0].x1': times[row],
      'annotations[0].x': times[row], 'annotations[0].text': `key frame ${row}`,
    }, rows.map((_, k) => k));
    for (const b of document.querySelectorAll('[data-row]')) if (b.tagName === 'B') b.textContent = row;
  }

  // A scene takes the wheel, or a finger, only after a click or tap: whoever scrolls past must not be caught.
  const hints = touch
    ? ['Tap it to turn it; until then the page scrolls.', 'One finger turns, two zoom. Tap beside it to scroll the page.']
    : ['Drag to turn it. The wheel zooms after a click into it, or with Ctrl.', 'The wheel zooms now. Move out of it to scroll the page.'];
  const plotlysOwn = { up: { x: 0, y: 0, z: 1 }, eye: { x: 1.25, y: 1.25, z: 1.25 } };

  function guard(div) {
    const hint = div.closest('figure').querySelector('.hint');
    const isAwake = () => div.classList.contains('awake');
    const wake = (on) => {
      div.classList.toggle('awake', on);
      hint.textContent = hints[on ? 1 : 0];
    };
    const held = { capture: true, passive: false };
    div.addEventListener('wheel', (event) => {
      if (event.ctrlKey) event.preventDefault(); // the browser would zoom the page too
      else if (!isAwake()) event.stopPropagation();
    }, held);
    for (const kind of ['touchstart', 'touchmove']) {
      div.addEventListener(kind, (event) => { if (!isAwake()) event.stopPropagation(); }, { capture: true, passive: true });
    }
    div.addEventListener('pointerdown', (event) => { if (event.pointerType === 'mouse') wake(true); }, held);
    div.addEventListener('click', () => wake(true), held);
    div.addEventListener('pointerleave', (event) => {
      if (event.pointerType === 'mouse' && !event.buttons) wake(false);
    });
    document.addEventListener('pointerdown', (event) => { if (!div.contains(event.target)) wake(false); });
    document.addEventListener('keydown', (event) => { if (event.key === 'Escape') wake(false); });
    wake(false);
  }
  document.querySelectorAll('.scene').forEach(guard);

  for (const button of document.querySelectorAll('.views button')) {
    button.addEventListener('click', () => {
      const div = button.closest('figure').querySelector('.plot');
      const camera = JSON.parse(button.dataset.camera) || themed(div.id).layout.scene.camera || plotlysOwn;
      Plotly.relayout(div, { 'scene.camera': { center: { x: 0, y: 0, z: 0 }, ...camera } });
    });
  }

  // The slider: the target along the sensor's view, x right, y down, z away, by the pose of the chosen frame.
  function makeFrames(canvas) {
    const data = JSON.parse(document.querySelector('script[data-for="frames"]').textContent);
    const poses = new Float32Array(bytesOf(data.poses).buffer);
    const seconds = new Float32Array(bytesOf(data.seconds).buffer);
    const vertices = new Float32Array(data.vertices ? bytesOf(data.vertices).buffer : 0);
    const triangles = new Uint32Array(data.triangles ? bytesOf(data.triangles).buffer : 0);
    const observed = data.observed ? bytesOf(data.observed) : [];
    const keys = new Set(data.keys);
    const slider = document.getElementById('frame');
    const [left, right, top, bottom] = data.window;
    canvas.style.aspectRatio = Math.min(Math.max((right - left) / (bottom - top), 1), 2.4);

    function rotation(k) {
      const [x, y, z, w] = poses.subarray(7 * k + 3, 7 * k + 7);
      return [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
      ];
    }

    function paint() {
      const k = Number(slider.value);
      const style = getComputedStyle(root);
      const [w, h, dpr] = [canvas.clientWidth, canvas.clientHeight, window.devicePixelRatio || 1];
      canvas.width = Math.round(w * dpr);
      canvas.height = Math.round(h * dpr);
      const pen = canvas.getContext('2d');
      pen.scale(dpr, dpr);
      const scale = Math.min(w / (right - left), h / (bottom - top));
      const [u0, v0] = [w / 2 - scale * (left + right) / 2, h / 2 - scale * (top + bottom) / 2];
      const R = rotation(k);
      const t = poses.subarray(7 * k, 7 * k + 3);
      const moved = (x, y, z) => [0, 1, 2].map((r) => R[3 * r] * x + R[3 * r + 1] * y + R[3 * r + 2] * z + t[r]);
      const pixel = (p) => [u0 + scale * p[0] / Math.max(p[2], 1e-3), v0 + scale * p[1] / Math.max(p[2], 1e-3)];

      const at = [];
      for (let i = 0; i < vertices.length; i += 3) at.push(moved(vertices[i], vertices[i + 1], vertices[i + 2]));
      const shades = ['--unseen', '--model'].map((name) => {
        const hex = style.getPropertyValue(name).trim();
        return [1, 3, 5].map((j) => parseInt(hex.slice(j, j + 2), 16));
      });
      const faces = [];
      for (let f = 0; f < triangles.length / 3; f += 1) {
        const [a, b, c] = [at[triangles[3 * f]], at[triangles[3 * f + 1]], at[triangles[3 * f + 2]]];
        const [p, q] = [[0, 1, 2].map((j) => b[j] - a[j]), [0, 1, 2].map((j) => c[j] - a[j])];
        const n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
        const facing = Math.abs(n[0] * a[0] + n[1] * a[1] + n[2] * a[2]) / (Math.hypot(...n) * Math.hypot(...a) || 1);
        faces.push([a[2] + b[2] + c[2], f, 0.4 + 0.6 * facing, [a, b, c].map(pixel)]);
      }
      faces.sort((one, other) => other[0] - one[0]);
      for (const [, f, light, corners] of faces) {
        const colour = `rgb(${shades[observed[f]].map((v) => Math.round(v * light)).join()})`;
        pen.fillStyle = pen.strokeStyle = colour;
        pen.beginPath();
        corners.forEach(([x, y], j) => (j ? pen.lineTo(x, y) : pen.moveTo(x, y)));
        pen.closePath();
        pen.fill();
        pen.stroke(); // else the background shows between neighbours
      }

      pen.strokeStyle = style.getPropertyValue('--ink');
      pen.lineWidth = 1.5;
      pen.beginPath();
      for (const [a, b] of [[-7, 0], [0, -7]]) { pen.moveTo(u0 + a, v0 + b); pen.lineTo(u0 - a, v0 - b); }
      pen.stroke();

      const origin = pixel(moved(0, 0, 0));
      pen.lineWidth = 2.5;
      pen.font = '600 14px system-ui, sans-serif';
      [['x', '--c5'], ['y', '--c3'], ['z', '--c1']].forEach(([name, colour], j) => {
        const tip = [0, 0, 0];
        tip[j] = data.axes;
        const end = pixel(moved(...tip));
        pen.strokeStyle = pen.fillStyle = style.getPropertyValue(colour);
        pen.beginPath();
        pen.moveTo(...origin);
        pen.lineTo(...end);
        pen.stroke();
        pen.fillText(name, end[0] + 4, end[1] - 4);
      });
      say(k, R, t);
    }

    function say(k, R, t) {
      const R0 = rotation(0);
      const trace = R.reduce((sum, v, j) => sum + v * R0[j], 0);
      const turned = Math.acos(Math.min(1, Math.max(-1, (trace - 1) / 2))) * 180 / Math.PI;
      const at = Array.from(t, (v) => (1e3 * v).toFixed(0).replace('-', '−')).join(', ');
      document.getElementById('pose').textContent =
        `${data.numbers[k]} of ${data.of}${keys.has(k) ? ', a key frame' : ''}: at ${seconds[k].toFixed(2)} s, `
        + `(${at}) mm, ${turned.toFixed(1)}° from the first attitude`;
    }

    slider.addEventListener('input', paint);
    new ResizeObserver(paint).observe(canvas);
    return paint;
  }
  const frames = document.getElementById('frames');
  const paintFrames = frames ? makeFrames(frames) : () => {};

  for (const table of document.querySelectorAll('table.sortable')) {
    const heads = [...table.querySelectorAll('th')];
    heads.forEach((head, column) => head.addEventListener('click', () => {
      const sign = head.getAttribute('aria-sort') === 'ascending' ? -1 : 1;
      heads.forEach((h) => h.removeAttribute('aria-sort'));
      head.setAttribute('aria-sort', sign > 0 ? 'ascending' : 'descending');
      const value = (row) => row.cells[column].textContent.trim();
      const compare = (a, b) => {
        const [x, y] = [value(a), value(b)];
        const [p, q] = [Number.parseFloat(x), Number.parseFloat(y)];
        if (Number.isNaN(p) !== Number.isNaN(q)) return Number.isNaN(p) ? 1 : -1; // what has no number comes last
        return sign * (Number.isNaN(p) ? x.localeCompare(y) : p - q);
      };
      const body = table.tBodies[0];
      body.append(...[...body.rows].sort(compare));
    }));
  }

  function setTheme(name) {
    root.dataset.theme = name;
    paintFrames();
    drawAll();
  }
  document.getElementById('theme').addEventListener('click', () => {
    setTheme(root.dataset.theme === 'dark' ? 'light' : 'dark');
  });
  dark.addEventListener('change', () => setTheme(dark.matches ? 'dark' : 'light'));

  function cannotDraw(error) {
    console.error(error);
    for (const div of document.querySelectorAll('.plot')) {
      div.classList.add('failed');
      div.textContent = 'The figures need a newer browser: Chrome 80, Firefox 113, Safari 16.4 or later.';
    }
    root.dataset.ready = 'yes';
  }

  unpackLibrary().then(drawAll).catch(cannotDraw).then(() => {
    const pairs = document.getElementById('pairs');
    if (pairs && pairs.on) pairs.on('plotly_click', (event) => selectRow(event.points[0].y));
  });
})();
