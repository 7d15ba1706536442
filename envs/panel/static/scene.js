// The machine in 3D: shapes of the MuJoCo model, drawn when something has moved.
import { THREE, OrbitControls } from "nicegui-scene";

const quaternion = (q) => new THREE.Quaternion(q[1], q[2], q[3], q[0]);

export default {
  template: `<div class="scene-host" data-test="scene"><canvas ref="canvas"></canvas></div>`,
  mounted() {
    this.bodies_ = new Map();
    this.ghosts_ = new Map();
    this.marks_ = [];
    this.scene_ = new THREE.Scene();
    this.camera_ = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    this.camera_.up.set(0, 0, 1);
    try {
      this.renderer_ = new THREE.WebGLRenderer({ canvas: this.$refs.canvas, antialias: true });
    } catch (error) {
      this.$el.textContent = "This browser has no WebGL: the machine cannot be drawn.";
      return;
    }
    this.renderer_.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer_.shadowMap.enabled = true;
    this.controls_ = new OrbitControls(this.camera_, this.$refs.canvas);
    this.controls_.addEventListener("change", () => this.render());
    this.scene_.add(new THREE.HemisphereLight(0xffffff, 0x9aa2ae, 1.5));
    this.sun_ = new THREE.DirectionalLight(0xffffff, 1.6);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.9); // comes with the eye: no face is black
    this.camera_.add(lamp);
    this.scene_.add(this.camera_);
    this.sun_.castShadow = true;
    this.sun_.shadow.mapSize.set(1024, 1024);
    this.scene_.add(this.sun_, this.sun_.target);
    this.watch_ = new ResizeObserver(() => this.fit());
    this.watch_.observe(this.$el);
    this.themes_ = new MutationObserver(() => this.theme());
    this.themes_.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.theme();
    this.$emit("ready");
  },
  beforeUnmount() {
    this.watch_?.disconnect();
    this.themes_?.disconnect();
    this.renderer_?.dispose();
  },
  methods: {
    colour(name) {
      return getComputedStyle(document.body).getPropertyValue(name).trim();
    },
    theme() {
      this.scene_.background = new THREE.Color(this.colour("--card"));
      if (this.scene_.fog) this.scene_.fog.color.set(this.colour("--card"));
      this.floor_?.material.color.set(this.colour("--floor"));
      this.render();
    },
    fit() {
      const box = this.$el.getBoundingClientRect();
      if (!this.renderer_ || box.width < 2) return;
      this.renderer_.setSize(box.width, box.height, false);
      this.camera_.aspect = box.width / box.height;
      this.camera_.updateProjectionMatrix();
      this.render();
    },
    geometry(shape) {
      const s = shape.size;
      switch (shape.kind) {
        case "box": return new THREE.BoxGeometry(2 * s[0], 2 * s[1], 2 * s[2]);
        case "sphere": return new THREE.SphereGeometry(s[0], 32, 20);
        case "ellipsoid": return new THREE.SphereGeometry(1, 32, 20).scale(s[0], s[1], s[2]);
        case "cylinder": return new THREE.CylinderGeometry(s[0], s[0], 2 * s[1], 40).rotateX(Math.PI / 2);
        case "capsule": return new THREE.CapsuleGeometry(s[0], 2 * s[1], 12, 24).rotateX(Math.PI / 2);
        case "mesh": {
          const g = new THREE.BufferGeometry();
          g.setAttribute("position", new THREE.Float32BufferAttribute(shape.vertices, 3));
          g.setIndex(shape.faces);
          g.computeVertexNormals();
          return g;
        }
        default: return null;
      }
    },
    build(told) {
      if (!this.renderer_) return;
      const low = new THREE.Vector3(...told.low), high = new THREE.Vector3(...told.high);
      const e = Math.max(low.distanceTo(high) / 1.6, 0.05), c = low.clone().add(high).multiplyScalar(0.5);
      for (const id of told.bodies) {
        for (const [map, on] of [[this.bodies_, true], [this.ghosts_, false]]) {
          const group = new THREE.Group();
          group.visible = on;
          map.set(id, group);
          this.scene_.add(group);
        }
      }
      this.order_ = told.bodies;
      for (const shape of told.shapes) {
        if (shape.kind === "plane") {
          if (this.floor_) continue;
          this.floor_ = this.floor(e);
          this.floor_.position.set(...shape.pos);
          this.floor_.quaternion.copy(quaternion(shape.quat));
          this.floor_.receiveShadow = true;
          this.scene_.add(this.floor_);
          continue;
        }
        const geometry = this.geometry(shape);
        if (!geometry) continue;
        const [r, g, b, a] = shape.colour;
        const make = (ghost) => {
          const material = new THREE.MeshStandardMaterial({ roughness: 0.55, metalness: 0.1, transparent: ghost || a < 1, opacity: ghost ? 0.28 : a, depthWrite: !ghost });
          material.color.setRGB(r, g, b, THREE.SRGBColorSpace);
          const mesh = new THREE.Mesh(geometry, material);
          mesh.position.set(...shape.pos);
          mesh.quaternion.copy(quaternion(shape.quat));
          if (shape.label) mesh.add(this.label(shape.label, e));
          mesh.castShadow = !ghost && !(shape.decor && Math.max(...shape.size) < 0.02);
          mesh.receiveShadow = !ghost && !shape.decor;
          return mesh;
        };
        if (this.bodies_.has(shape.body)) {
          this.bodies_.get(shape.body).add(make(false));
          if (!shape.decor) this.ghosts_.get(shape.body).add(make(true));
        } else this.scene_.add(make(false));
      }
      const colours = { software_limit: "--warn", home_switch: "--good" };
      for (const mark of told.marks) {
        const wide = 0.16 * Math.min(e, 1.2);
        const material = new THREE.MeshBasicMaterial({ color: this.colour(colours[mark.kind] || "--bad"), transparent: true, opacity: 0.22, side: THREE.DoubleSide, depthWrite: false });
        const mesh = new THREE.Mesh(new THREE.BoxGeometry(Math.max(mark.length, 0.002), wide, wide), material);
        mesh.position.set(...mark.pos);
        mesh.quaternion.setFromUnitVectors(new THREE.Vector3(1, 0, 0), new THREE.Vector3(...mark.along));
        this.scene_.add(mesh);
        this.marks_.push([mark, mesh]);
      }
      this.home_ = () => {
        this.controls_.target.copy(c);
        const [turn, lift] = told.view.map((angle) => (angle * Math.PI) / 180);
        const away = new THREE.Vector3(-Math.cos(lift) * Math.cos(turn), -Math.cos(lift) * Math.sin(turn), -Math.sin(lift));
        const right = new THREE.Vector3(0, 0, 1).cross(away).normalize(), up = away.clone().cross(right);
        const tall = Math.tan((this.camera_.fov * Math.PI) / 360) / 1.08, wide = tall * this.camera_.aspect;
        let far = 0; // until each corner is in sight, in a narrow window too
        for (let i = 0; i < 8; i++) {
          const p = new THREE.Vector3(i & 1 ? high.x : low.x, i & 2 ? high.y : low.y, i & 4 ? high.z : low.z).sub(c);
          far = Math.max(far, p.dot(away) + Math.max(Math.abs(p.dot(right)) / wide, Math.abs(p.dot(up)) / tall));
        }
        this.camera_.position.copy(c).addScaledVector(away, far);
        this.controls_.update();
        this.render();
      };
      if (told.floor != null) {
        this.scene_.fog = new THREE.Fog(this.colour("--card"), 4 * e, 9 * e);
      }
      this.sun_.position.set(c.x - e, c.y - 1.5 * e, c.z + 3 * e);
      this.sun_.target.position.copy(c);
      const s = this.sun_.shadow.camera;
      s.left = s.bottom = -2 * e; s.right = s.top = 2 * e; s.far = 10 * e;
      s.updateProjectionMatrix();
      this.fit();
      this.home_();
    },
    floor(e) {
      const size = 24 * e, step = e > 3 ? 1 : 0.1; // m, of a square
      const canvas = document.createElement("canvas"), c = canvas.getContext("2d");
      canvas.width = canvas.height = 64;
      c.fillStyle = "#ffffff"; c.fillRect(0, 0, 64, 64);
      c.fillStyle = "#ededed"; c.fillRect(0, 0, 32, 32); c.fillRect(32, 32, 32, 32);
      const map = new THREE.CanvasTexture(canvas);
      map.colorSpace = THREE.SRGBColorSpace;
      map.wrapS = map.wrapT = THREE.RepeatWrapping;
      map.repeat.setScalar(size / (2 * step));
      map.anisotropy = 8;
      return new THREE.Mesh(new THREE.PlaneGeometry(size, size), new THREE.MeshLambertMaterial({ color: this.colour("--floor"), map }));
    },
    label(text, e) {
      const canvas = document.createElement("canvas"), c = canvas.getContext("2d");
      canvas.width = 128; canvas.height = 48;
      c.font = "600 34px Roboto, sans-serif"; c.textAlign = "center"; c.textBaseline = "middle";
      c.lineWidth = 7; c.strokeStyle = "#ffffffdd"; c.strokeText(text, 64, 25);
      c.fillStyle = "#10151c"; c.fillText(text, 64, 25);
      const map = new THREE.CanvasTexture(canvas);
      map.colorSpace = THREE.SRGBColorSpace;
      const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthTest: false }));
      sprite.scale.set(0.16 * e, 0.06 * e, 1);
      return sprite;
    },
    home() {
      this.home_?.();
    },
    place(map, poses) {
      this.order_.forEach((id, i) => {
        const p = poses.slice(7 * i, 7 * i + 7), group = map.get(id);
        group.position.set(p[0], p[1], p[2]);
        group.quaternion.set(p[4], p[5], p[6], p[3]);
      });
    },
    show(told) {
      if (!this.order_) return;
      this.place(this.bodies_, told.now);
      for (const group of this.ghosts_.values()) group.visible = !!told.ghost;
      if (told.ghost) this.place(this.ghosts_, told.ghost);
      for (const [mark, mesh] of this.marks_) {
        mesh.material.opacity = mark.switch >= 0 && told.switches[mark.axis][mark.switch] ? 0.75 : 0.22;
      }
      this.$el.dataset.at = told.now.slice(0, 3).join(" ");
      this.render();
    },
    render() {
      if (this.renderer_ && this.order_ && this.$el.offsetParent) this.renderer_.render(this.scene_, this.camera_);
    },
  },
};
