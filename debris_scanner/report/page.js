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
    const bytes = Uint8Array.from(atob(document.getElementById('library').textContent), (c) => c.charCodeAt(0));
    const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
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

  function numbers(array) {
    if (!array.bdata) return Array.from(array);
    const bytes = Uint8Array.from(atob(array.bdata), (c) => c.charCodeAt(0));
    const Kind = array.dtype === 'f4' ? Float32Array : Float64Array;
    return Array.from(new Kind(bytes.buffer));
  }

  // A click into the map of pairs shows that key frame's row in the plot above it.
  function selectRow(row) {
    const pairs = document.getElementById('pairs');
    const lines = document.getElementById('likeness');
    const times = numbers(lines.data[0].x);
    if (row < 0 || row >= times.length) return;
    pairs.dataset.row = row;
    const rows = pairs.data.filter((t) => t.type === 'heatmap').map((t) => {
      const flat = numbers(t.z);
      return flat.slice(row * times.length, (row + 1) * times.length);
    });
    Plotly.update(lines, { y: rows }, {
      'shapes[0].x0': times[row], 'shapes[0].x1': times[row],
      'annotations[0].x': times[row], 'annotations[0].text': `key frame ${row}`,
    }, rows.map((_, k) => k));
    for (const b of document.querySelectorAll('[data-row]')) if (b.tagName === 'B') b.textContent = row;
  }

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
