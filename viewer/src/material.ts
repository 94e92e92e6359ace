// How a surface is drawn: albedo times light map, tone-mapped by three.js with the same AgX as the service's pictures.

import { Color, DoubleSide, FrontSide, ShaderMaterial, Vector3 } from 'three';

/** What all surfaces share; one object, so that a change reaches every material. */
export const shared = {
  /** 0 radiance, 1 the light map alone, 2 change. */
  mode: { value: 0 },
  /** Draw the light before the edit. */
  before: { value: 0 },
  /** Add emission: not in the view of indirect light. */
  emissive: { value: 1 },
  /** What the ends of the colour scale of a change stand for. */
  scale: { value: 1 },
};

const vertexShader = /* glsl */ `
  attribute vec3 light;
  attribute vec3 base;
  varying vec3 vLight;
  varying vec3 vBase;
  varying vec3 vNormal;
  varying vec3 vView;
  void main() {
    vec4 view = modelViewMatrix * vec4(position, 1.0);
    vLight = light;
    vBase = base;
    vNormal = normalMatrix * normal;
    vView = view.xyz;
    gl_Position = projectionMatrix * view;
  }`;

const fragmentShader = /* glsl */ `
  uniform int mode;
  uniform float before;
  uniform float emissive;
  uniform float scale;
  uniform float selected;
  uniform vec3 albedo;
  uniform vec3 emission;
  uniform float opacity;
  varying vec3 vLight;
  varying vec3 vBase;
  varying vec3 vNormal;
  varying vec3 vView;

  // Blue is less, grey nothing, red more: the colours of the service's pictures, in sRGB.
  vec3 diverging(float t) {
    vec3 less = vec3(59.0, 76.0, 192.0) / 255.0, bit_less = vec3(141.0, 176.0, 254.0) / 255.0;
    vec3 none = vec3(221.0 / 255.0);
    vec3 bit_more = vec3(244.0, 154.0, 123.0) / 255.0, more = vec3(180.0, 4.0, 38.0) / 255.0;
    float x = clamp(t, -1.0, 1.0) * 2.0;
    if (x < -1.0) return mix(bit_less, less, -x - 1.0);
    if (x < 0.0) return mix(none, bit_less, -x);
    if (x < 1.0) return mix(none, bit_more, x);
    return mix(bit_more, more, x - 1.0);
  }

  void main() {
    float facing = abs(dot(normalize(vNormal), normalize(vView)));
    if (mode == 2) {
      // Elements that the edit brought have nothing to be compared with: a value far below 0 marks them.
      float change = vBase.x < -1e29 ? 0.0 : dot(vLight - vBase, vec3(1.0 / 3.0));
      gl_FragColor = vec4(diverging(change / scale) * (0.45 + 0.55 * facing), opacity);
    } else {
      vec3 light = before > 0.5 && vBase.x > -1e29 ? vBase : vLight;
      vec3 radiance = mode == 1 ? light : albedo * light + emission * emissive;
      gl_FragColor = vec4(radiance, opacity);
      #include <tonemapping_fragment>
      #include <colorspace_fragment>
    }
    // A rim, not a tint: the light under it stays readable.
    gl_FragColor.rgb = mix(gl_FragColor.rgb, vec3(0.3, 0.7, 1.0), selected * (0.12 + 0.6 * pow(1.0 - facing, 3.0)));
  }`;

/** The material of one primitive. Light goes through where its opacity is below 1. */
export function surface(albedo: Color, emission: Color, doubleSided: boolean, opacity: number): ShaderMaterial {
  return new ShaderMaterial({
    transparent: opacity < 1,
    depthWrite: opacity >= 1,
    vertexShader,
    fragmentShader,
    side: doubleSided ? DoubleSide : FrontSide,
    uniforms: {
      ...shared,
      selected: { value: 0 },
      albedo: { value: new Vector3(albedo.r, albedo.g, albedo.b) },
      emission: { value: new Vector3(emission.r, emission.g, emission.b) },
      opacity: { value: opacity },
    },
  });
}
