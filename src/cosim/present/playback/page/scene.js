"use strict";
/* The bodies, loads and paths of runs in three dimensions.

   A row of a result holds place (3) and rotation matrix (9, by columns) of each body, point and
   vector (3 each) of each load, and point (3) of each path. `value(run, i, j)` is number j of row i. */
const THREE = MeshCat.THREE;
const DARK = window.matchMedia("(prefers-color-scheme: dark)");
const BODY = 12, LOAD = 6, POINT = 3;
const FARTHEST = 6; // distance of what a picture must show from its middle, over half the size of the first run

const value = (run, i, j) => run.rows[i * run.across + j * run.down];
const triple = (run, i, j) => [0, 1, 2].map((k) => value(run, i, j + k));

/* The row at or before a time, and how far to the next one, 0 ... 1. */
function station(times, t) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  if (t >= times[high]) return [high, high, 0]; // the last of several rows at this time
  const gap = times[high] - times[low];
  return [low, high, gap > 0 ? Math.max(0, (t - times[low]) / gap) : 0];
}

/* A cylinder of given radii below and above along the third axis. */
function rod(radius, length, above = radius) {
  return new THREE.CylinderGeometry(above, radius, length, 24).rotateX(Math.PI / 2);
}

/* A rod between two points. */
function between(a, b, radius) {
  const way = b.clone().sub(a), middle = a.clone().add(b).multiplyScalar(0.5);
  return rod(radius, way.length()).applyQuaternion(onto(way)).translate(middle.x, middle.y, middle.z);
}

/* The smallest rotation that turns the third axis into a direction. */
function onto(direction) {
  const axis = new THREE.Vector3(0, 0, 1);
  if (!(direction.length() > 0)) return new THREE.Quaternion();
  return new THREE.Quaternion().setFromUnitVectors(axis, direction.clone().normalize());
}

/* The corners of a mesh in the frame of its group's body. */
function boxed(mesh, group) {
  if (!mesh.geometry.boundingBox) mesh.geometry.computeBoundingBox();
  group.updateMatrix();
  const { min, max } = mesh.geometry.boundingBox;
  return [min.x, max.x].flatMap((x) => [min.y, max.y].flatMap((y) => [min.z, max.z].map((z) =>
    new THREE.Vector3(x, y, z).applyMatrix4(group.matrix))));
}

const GEOMETRIES = {
  box: (s) => [new THREE.BoxGeometry(...s)],
  cylinder: ([radius, length]) => [rod(radius, length)],
  sphere: ([radius]) => [new THREE.SphereGeometry(radius, 24, 16)],
  wheel: ([radius, tire]) => [
    new THREE.TorusGeometry(radius - tire, tire, 12, 48),
    rod(1.2 * tire, 3 * tire),
    ...[0, 1, 2].map((k) =>
      rod(0.25 * tire, 2 * (radius - tire)).rotateX(Math.PI / 2).rotateZ((k * Math.PI) / 3)),
  ],
  axes: ([length]) => [0, 1, 2].map((k) =>
    between(new THREE.Vector3(), new THREE.Vector3().setComponent(k, length), 0.02 * length)),
  line: (s) => {
    const corners = [];
    for (let i = 0; i < s.length; i += 3) corners.push(new THREE.Vector3(...s.slice(i, i + 3)));
    const pairs = corners.slice(1).map((corner, i) => [corners[i], corner]);
    const length = pairs.reduce((sum, [a, b]) => sum + a.distanceTo(b), 0);
    return pairs.map(([a, b]) => between(a, b, 0.004 * length));
  },
};

/* A short text that always faces the camera. */
function label(text, height, color) {
  const canvas = document.createElement("canvas"), size = 64;
  canvas.height = size;
  const pen = canvas.getContext("2d"), font = `${size * 0.75}px system-ui, sans-serif`;
  pen.font = font;
  canvas.width = Math.ceil(pen.measureText(text).width) + 8;
  pen.font = font;
  pen.fillStyle = color;
  pen.fillText(text, 4, size * 0.75);
  const material = new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false });
  const sprite = new THREE.Sprite(material);
  sprite.scale.set((height * canvas.width) / size, height, 1);
  return sprite;
}

/* One run: its bodies with shapes and axes, its loads and its paths. */
class Actor {
  constructor(data, ghost) {
    this.data = data;
    this.ghost = ghost;
    this.root = new THREE.Group();
    this.aside = new THREE.Vector3();
    this.bodies = data.bodies.map((name, i) => {
      const body = new THREE.Group(), axes = new THREE.AxesHelper(0.35 * data.pose);
      axes.visible = false;
      body.add(axes);
      this.root.add(body);
      return { body, axes: i && !name.includes("/") ? axes : null }; // not of the world and of parts
    });
    this.shapes = data.solids.map((solid) => {
      const material = new THREE.MeshStandardMaterial({
        color: solid.color, roughness: 0.6, transparent: ghost, opacity: ghost ? 0.35 : 1 });
      const group = new THREE.Group();
      group.userData.text = solid.name;
      this.bodies[solid.body].body.add(group);
      return { solid, material, group, numbers: "" };
    });
    this.loads = ghost ? [] : data.loads.map((load) => this.arrow(load));
    this.paths = data.paths.map((path) => {
      const material = new THREE.LineBasicMaterial({ color: path.color, transparent: ghost, opacity: ghost ? 0.4 : 1 });
      const line = new THREE.Line(new THREE.BufferGeometry(), material);
      line.frustumCulled = false;
      this.root.add(line);
      return line;
    });
  }

  arrow(load) {
    const material = new THREE.MeshStandardMaterial({ color: load.color });
    const size = this.data.pose, group = new THREE.Group();
    const shaft = new THREE.Mesh(rod(0.012 * size, 1).translate(0, 0, 0.5), material);
    const head = new THREE.Mesh(rod(0.03 * size, 0.07 * size, 0).translate(0, 0, -0.035 * size), material);
    group.add(shaft, head);
    this.root.add(group);
    return { load, group, shaft, head };
  }

  /* Takes another run; shapes are made again where their sizes differ. */
  take(run) {
    const { data } = this;
    this.run = run;
    if (data.live) this.scale();
    let next = 0;
    for (const shape of this.shapes) {
      const count = shape.solid.numbers, own = run.shapes.slice(next, next + count + 6);
      next += count + 6;
      if (shape.numbers === own.join()) continue;
      shape.numbers = own.join();
      for (const mesh of [...shape.group.children]) {
        mesh.geometry.dispose();
        shape.group.remove(mesh);
      }
      for (const geometry of GEOMETRIES[shape.solid.kind](own.slice(0, count)))
        shape.group.add(new THREE.Mesh(geometry, shape.material));
      shape.group.position.set(...own.slice(count, count + 3));
      shape.group.quaternion.copy(onto(new THREE.Vector3(...own.slice(count + 3))));
    }
    const first = data.bodies.length * BODY + data.loads.length * LOAD;
    this.paths.forEach((line, k) => {
      const points = new Float32Array(3 * run.time.length);
      for (let i = 0; i < run.time.length; ++i) points.set(triple(run, i, first + k * POINT), 3 * i);
      line.geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    });
  }

  /* Scales the arrows of each unit by the largest load while the run is valid, short peaks aside. */
  scale() {
    const { run, data } = this, base = data.bodies.length * BODY, sizes = new Map();
    const end = run.time.findIndex((t) => run.invalid_from !== null && t >= run.invalid_from);
    const valid = end > 0 ? end : run.time.length;
    data.loads.forEach(({ unit }, k) => {
      if (!sizes.has(unit)) sizes.set(unit, new Float64Array(valid));
      const most = sizes.get(unit);
      for (let i = 0; i < valid; ++i)
        most[i] = Math.max(most[i], Math.hypot(...triple(run, i, base + k * LOAD + 3)));
    });
    for (const load of data.loads) {
      const all = sizes.get(load.unit), most = all.reduce((a, b) => (b > a ? b : a), 0);
      const acting = all.filter((size) => size > data.nothing * most).sort();
      const usual = acting[Math.floor(data.usual * (acting.length - 1))] || Infinity;
      load.per_unit = data.longest / Math.min(most || Infinity, data.peak * usual);
    }
  }

  turn(i, body) {
    const m = Array.from({ length: 9 }, (_, k) => value(this.run, i, body * BODY + 3 + k));
    const matrix = new THREE.Matrix4().fromArray(
      [m[0], m[1], m[2], 0, m[3], m[4], m[5], 0, m[6], m[7], m[8], 0, 0, 0, 0, 1]);
    return new THREE.Quaternion().setFromRotationMatrix(matrix);
  }

  place(t, column) {
    const [i, j, s] = station(this.run.time, t);
    return new THREE.Vector3(...triple(this.run, i, column)).lerp(
      new THREE.Vector3(...triple(this.run, j, column)), s);
  }

  /* The middle of a body's shapes. */
  middle(t, body) {
    const [i, j, s] = station(this.run.time, t), turn = this.turn(i, body).slerp(this.turn(j, body), s);
    return new THREE.Vector3(...this.data.middle).applyQuaternion(turn).add(this.place(t, body * BODY));
  }

  show(t) {
    const { run, data } = this, [i, j, s] = station(run.time, t);
    this.bodies.forEach(({ body }, k) => {
      body.position.copy(this.place(t, k * BODY));
      body.quaternion.copy(this.turn(i, k).slerp(this.turn(j, k), s));
    });
    const base = data.bodies.length * BODY;
    this.loads.forEach(({ load, group, shaft, head }, k) => {
      const vector = this.place(t, base + k * LOAD + 3), size = vector.length();
      const length = Math.min(size * load.per_unit, data.longest);
      group.visible = length > 1e-6 * data.pose;
      group.position.copy(this.place(t, base + k * LOAD));
      group.quaternion.copy(onto(vector));
      shaft.scale.set(1, 1, Math.max(length - 0.07 * data.pose, 1e-9 * data.pose));
      head.position.z = length;
      head.scale.setScalar(Math.min(1, length / (0.1 * data.pose)));
      group.userData.text = `${load.name}: ${shown(size * load.factor)} ${load.unit}, ${load.meaning}` +
        ` (${shown(0.1 * data.pose / load.per_unit * load.factor)} ${load.unit} are ${shown(0.1 * data.pose)} m long)`;
    });
    const invalid = run.invalid_from !== null && t >= run.invalid_from;
    for (const { solid, material } of this.shapes) {
      material.color.set(invalid ? data.invalid_color : solid.color);
      Object.assign(material, { transparent: this.ghost || invalid, opacity: this.ghost || invalid ? 0.35 : 1 });
    }
  }
}

const shown = (number) => String(Number(Number(number).toPrecision(4)));

/* A number in a field, with as many of its digits as there is room for. */
function fitting(number) {
  const plain = String(Number(number.toPrecision(6)));
  return plain.length > 9 ? Number(number.toPrecision(4)).toExponential() : plain;
}

/* A time with three digits, s, from 10 s on with hundredths. */
const moment = (t) => Number(Math.abs(t) < 10 ? t.toPrecision(3) : t.toFixed(2));

/* A number with the digits that tell it from others at a distance such as 1, 2, 2.5 or 5. */
function stepped(number, step) {
  const digits = Math.floor(Math.log10(Math.abs(number) / step)) + 3;
  return digits > -6 ? String(Number(number.toPrecision(Math.min(Math.max(digits, 1), 15)))) : "0";
}

/* All runs, the ground, and a camera that is turned with the pointer. */
class Scene {
  constructor(data, place) {
    this.data = data;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.canvas = place.appendChild(this.renderer.domElement);
    this.canvas.tabIndex = 0;
    this.scene = new THREE.Scene();
    this.root = new THREE.Group();
    this.scene.add(this.root);
    this.up = new THREE.Vector3(...data.world.up);
    this.camera = new THREE.PerspectiveCamera(data.camera.field, 1, 0.01 * data.size, 200 * data.size);
    this.camera.up.copy(this.up);
    const sun = new THREE.DirectionalLight("#ffffff", 0.55);
    this.sun = sun;
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#8a8f94", 0.75), sun, sun.target);
    this.ground = null;
    this.paint();
    this.actors = data.runs.map((_, i) => new Actor(data, i > 0));
    for (const actor of this.actors) this.root.add(actor.root);
    const axes = new THREE.AxesHelper(0.25 * data.pose);
    this.root.add(axes);
    data.world.axes.forEach((name, k) => {
      const mark = label(name, 0.1 * data.pose, ["#c04040", "#2a8a2a", "#4060d0"][k]);
      mark.position.setComponent(k, 0.3 * data.pose);
      this.root.add(mark);
    });
    this.fit();
    this.listen();
  }

  paint() {
    const dark = DARK.matches, { data } = this, paper = dark ? "#16191c" : "#f7f9fa";
    this.scene.background = new THREE.Color(paper);
    this.scene.fog = new THREE.Fog(paper, 6 * data.size, 30 * data.size);
    if (this.ground) this.scene.remove(this.ground);
    const cells = 4 * Math.ceil((20 * data.size) / data.cell / 4);
    this.ground = new THREE.GridHelper(cells * data.cell, cells, dark ? "#59626a" : "#aab3ba", dark ? "#2c3238" : "#d9dfe3");
    this.ground.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), this.up.clone().normalize());
    this.scene.add(this.ground);
  }

  /* The first view: everything that the runs show fills the picture below its title and buttons. */
  fit() {
    const { data, camera } = this, { clientHeight: height } = this.canvas.parentElement;
    const texts = Math.max(...[$("facts"), $("buttons")].map((e) => e.offsetTop + Math.min(e.offsetHeight, 44)));
    this.center = new THREE.Vector3(...data.camera.center);
    this.from = new THREE.Vector3(...data.camera.eye).sub(this.center);
    this.fitted = true;
    // a body that is followed may come to lie in any direction of the ground, as runs of sliders do
    const up = this.up.clone().normalize(), turns = data.live && data.follow >= 0 ? 8 : 1;
    const turned = (p, k) => new THREE.Vector3(...p).sub(this.center)
      .applyAxisAngle(up, (2 * Math.PI * k) / turns).add(this.center);
    const points = this.actors.flatMap((actor) => [...data.framed, ...this.corners(actor)].flatMap((p) =>
      Array.from({ length: turns }, (_, k) => turned(p, k).add(actor.aside))));
    const reach = Math.max(...points.map((point) => point.distanceTo(this.center)));
    const slope = Math.tan((data.camera.field * Math.PI) / 360), top = Math.min(0.6, (2 * texts) / (height || 1));
    const room = [0.94, 0.94 - top / 2];
    this.from.setLength(Math.max(this.from.length(), 2 * reach));
    for (let round = 0; round < 8; ++round) {
      this.aim();
      const seen = points.map((point) => point.clone().applyMatrix4(camera.matrixWorldInverse));
      const [low, high] = [Math.min, Math.max].map((pick) => [
        pick(...seen.map((p) => p.x / (-p.z * slope * camera.aspect))), pick(...seen.map((p) => p.y / (-p.z * slope)))]);
      const middle = [0, 1].map((k) => (low[k] + high[k]) / 2 + (k ? top / 2 : 0)), away = this.from.length();
      const [x, y] = [0, 1].map((k) => new THREE.Vector3().setFromMatrixColumn(camera.matrix, k));
      this.center.addScaledVector(x, middle[0] * slope * camera.aspect * away).addScaledVector(y, middle[1] * slope * away);
      this.from.multiplyScalar(Math.max(...[0, 1].map((k) => (high[k] - low[k]) / 2 / room[k])));
    }
  }

  /* Outermost corners of the shapes while a run of sliders is valid, where a camera that follows it
     sees them; a shape that goes far away may leave the picture. */
  corners(actor) {
    const { run } = actor, { data } = this, center = new THREE.Vector3(...data.camera.center);
    if (!data.live || !run) return [];
    const sides = [-1, 0, 1], outward = sides.flatMap((x) => sides.flatMap((y) => sides.map((z) =>
      ({ way: new THREE.Vector3(x, y, z), most: -Infinity, corner: new THREE.Vector3() }))));
    const boxes = actor.bodies.map(({ body }) => actor.shapes.flatMap(({ group }) =>
      group.parent === body ? group.children.flatMap((mesh) => boxed(mesh, group)) : []));
    const end = run.invalid_from === null ? Infinity : run.invalid_from, matrix = new THREE.Matrix4();
    const point = new THREE.Vector3(), step = Math.ceil(run.time.length / 500);
    for (let i = 0; i < run.time.length && run.time[i] <= end; i += step) {
      const along = this.followed(actor, run.time[i]).add(center);
      boxes.forEach((corners, k) => {
        const [x, y, z, ...m] = Array.from({ length: BODY }, (_, j) => value(run, i, k * BODY + j));
        matrix.set(m[0], m[3], m[6], x, m[1], m[4], m[7], y, m[2], m[5], m[8], z, 0, 0, 0, 1);
        for (const corner of corners) {
          point.copy(corner).applyMatrix4(matrix).sub(along);
          for (const found of outward) {
            const size = point.dot(found.way);
            if (size <= found.most) continue;
            found.most = size;
            found.corner.copy(point);
          }
        }
      });
    }
    return outward.map(({ corner }) => corner.clampLength(0, FARTHEST * data.size).add(center).toArray());
  }

  /* Puts the camera where it belongs. */
  aim() {
    this.camera.position.copy(this.center).add(this.from);
    this.camera.lookAt(this.center);
    this.camera.updateMatrix();
    this.camera.updateMatrixWorld();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(width, height, false);
    if (this.fitted) this.fit();
  }

  turn(right, upward) {
    this.fitted = false;
    const up = this.up.clone().normalize();
    this.from.applyAxisAngle(up, -right);
    const side = new THREE.Vector3().crossVectors(up, this.from).normalize();
    const tilted = this.from.clone().applyAxisAngle(side, -upward);
    if (tilted.angleTo(up) > 0.05 && tilted.angleTo(up) < Math.PI - 0.05) this.from.copy(tilted);
  }

  shift(right, upward) {
    this.fitted = false;
    const unit = this.from.length() * Math.tan((this.data.camera.field * Math.PI) / 360) / this.canvas.clientHeight * 2;
    const x = new THREE.Vector3().setFromMatrixColumn(this.camera.matrix, 0);
    const y = new THREE.Vector3().setFromMatrixColumn(this.camera.matrix, 1);
    this.center.addScaledVector(x, -right * unit).addScaledVector(y, upward * unit);
  }

  zoom(factor) {
    this.fitted = false;
    const { size } = this.data;
    this.from.setLength(Math.min(60 * size, Math.max(0.1 * size, this.from.length() * factor)));
  }

  listen() {
    const { canvas } = this, fingers = new Map();
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
    });
    canvas.addEventListener("pointermove", (e) => {
      const before = fingers.get(e.pointerId);
      if (!before) return;
      const right = e.clientX - before.x, down = e.clientY - before.y;
      const gap = fingers.size === 2 ? spread() : 0;
      fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
      if (fingers.size === 2) {
        this.zoom(gap / Math.max(1, spread()));
        this.shift(right / 2, down / 2);
      } else if (e.buttons === 2 || e.shiftKey) {
        this.shift(right, down);
      } else {
        this.turn(right * 0.008, down * 0.008);
      }
    });
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (e) => fingers.delete(e.pointerId));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(0.001 * e.deltaY));
    }, { passive: false });
  }

  /* What is at a place of the canvas, in words; "" for nothing. */
  at(x, y) {
    const box = this.canvas.getBoundingClientRect(), caster = new THREE.Raycaster();
    const place = new THREE.Vector2(((x - box.left) / box.width) * 2 - 1, 1 - ((y - box.top) / box.height) * 2);
    caster.setFromCamera(place, this.camera);
    const targets = [...this.actors[0].loads.map((l) => l.group), ...this.actors[0].shapes.map((s) => s.group)];
    const hit = caster.intersectObjects(targets.filter((t) => t.visible), true)[0];
    return hit ? hit.object.parent.userData.text || "" : "";
  }

  beside(apart) {
    const side = new THREE.Vector3().crossVectors(this.up, this.from).setLength(2.2 * this.data.pose);
    this.actors.forEach((actor, i) => actor.aside.copy(side).multiplyScalar(apart ? i : 0));
    this.fit();
  }

  axes(visible) {
    for (const actor of this.actors) for (const { axes } of actor.bodies) if (axes) axes.visible = visible;
  }

  /* How far a run moves along the ground with the body that the camera follows. */
  followed(actor, t) {
    const { follow } = this.data;
    if (follow < 0 || !actor.run) return new THREE.Vector3();
    const along = actor.middle(t, follow).sub(actor.middle(actor.run.time[0], follow)), up = this.up.clone().normalize();
    return along.addScaledVector(up, -along.dot(up));
  }

  draw(t) {
    const { data } = this;
    for (const actor of this.actors) actor.show(t);
    const along = this.followed(this.actors[0], t);
    for (const actor of this.actors) // ghosts move along with the first run
      actor.root.position.copy(along).sub(this.followed(actor, t)).add(actor.aside);
    this.root.position.copy(along).negate();
    const cell = (k) => -(along.getComponent(k) % (4 * data.cell));
    this.ground.position.set(cell(0), cell(1), cell(2));
    if (!data.world.ground) this.ground.position.addScaledVector(this.up, data.floor);
    this.aim();
    this.sun.target.position.copy(this.center);
    this.sun.position.copy(this.camera.position).addScaledVector(this.up, data.size);
    this.renderer.render(this.scene, this.camera);
  }
}
