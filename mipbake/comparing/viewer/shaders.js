// GLSL of the viewer. docs/conventions.md has the formulas, their names and their guards.

const MAX_LIGHTS = 64;

const VERTEX_SHADER = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 tangent;
layout(location = 3) in vec2 uv;
uniform mat4 uClip;
uniform vec2 uTiling, uShift;  // whole textures off, where it repeats: small coordinates are precise ones
out vec3 vPosition;
out vec3 vNormal;
out vec3 vTangent;
out vec2 vUv;
void main() {
    vPosition = position;
    vNormal = normal;
    vTangent = tangent;
    vUv = uv * uTiling - uShift;
    gl_Position = uClip * vec4(position, 1.0);
}`;

// One program per model. SURFACE_OF_MODEL, which the page's author puts before this script, has what each makes of its
// maps: the body of surfaceAt. uSamples = 0 looks up once per pixel, as a game would; otherwise the pixel filter is
// integrated over that many bilinear lookups of level 0, and blended with the passes before.
const fragmentShader = (model) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
in vec3 vPosition;
in vec3 vNormal;
in vec3 vTangent;
in vec2 vUv;
uniform sampler2D uMap0, uMap1, uMap2, uFilter, uPrevious;
uniform vec2 uSigned;  // factor and offset that undo the storage of signed values
uniform float uLastLevel;
uniform vec3 uEye;
uniform int uLights;
uniform vec3 uDirection[${MAX_LIGHTS}], uRadiance[${MAX_LIGHTS}];
uniform float uWiden;  // added to both eigenvalues of the roughness tensor
uniform int uShow, uSamples;
uniform vec2 uStart;
uniform float uBlend;
out vec4 outColor;

const float PI = 3.14159265358979;
// tensor: S11, S22, S12; gamma: exponent of the generalised Beckmann distribution, 0 for GGX; norm: 1 / Gamma(1 + 1/gamma).
struct Surface { vec3 albedo, f0, normal, tensor; float dielectric, gamma, norm; };

float pow2(float x) { return x * x; }

Surface metallicRoughness(vec4 base, vec4 rest) {
    Surface s;
    vec3 n = rest.xyz * uSigned.x + uSigned.y;
    float len = length(n);
    s.normal = len > 1e-6 ? n / len : vec3(0, 0, 1);
    s.albedo = base.rgb * (1.0 - base.a);
    s.f0 = mix(vec3(0.04), base.rgb, base.a);
    s.dielectric = 1.0;
    s.gamma = 0.0;
    s.tensor = vec3(vec2(pow2(pow2(max(rest.w, 0.045)))), 0);
    return s;
}

Surface tensorModel(vec4 first, vec4 second, vec4 third) {
    Surface s;
    vec2 xy = vec2(first.w, second.w);
    xy /= max(length(xy), 1.0);
    s.normal = vec3(xy, sqrt(max(1.0 - dot(xy, xy), 0.0)));
    s.albedo = first.rgb;
    s.f0 = second.rgb;
    s.dielectric = 0.0;
    float m = clamp(0.5 * (third.x + third.y), -30.0, 10.0), d = 0.5 * (third.x - third.y), c = third.z;
    float q = min(sqrt(d * d + c * c), 20.0);
    float sinhc = q > 0.01 ? sinh(q) / q : 1.0 + q * q / 6.0;
    s.tensor = exp(m) * vec3(cosh(q) + sinhc * d, cosh(q) - sinhc * d, sinhc * c);
    s.gamma = 0.0;
    return s;
}

// 1 / Gamma(x) for x from 1 to 6: Stirling's series at x + 7.
float inverseGamma(float x) {
    float product = x;
    for (float i = 1.0; i < 6.5; ++i) product *= x + i;
    float y = x + 7.0;
    return product * exp(y - (y - 0.5) * log(y) - 0.9189385 - (1.0 / 12.0 - 1.0 / (360.0 * y * y)) / y);
}

Surface surfaceAt(vec2 uv, float lod) {${SURFACE_OF_MODEL[model]}
}

// Components of w along t = normalize(x - (x.n) n), b = n x t, and n.
vec3 inFrame(vec3 w, vec3 n) {
    float p = n.y * n.y + n.z * n.z;
    float side = n.x > 0.0 ? -1.0 : 1.0;
    vec3 b = p > 1e-16 ? vec3(0, n.z, -n.y) * inversesqrt(p) : vec3(0, -side * n.x, 0);
    vec3 t = p > 1e-16 ? cross(b, n) : vec3(0, 0, side);
    return vec3(dot(w, t), dot(w, b), dot(w, n));
}

float form(vec3 tensor, vec3 w) {
    return tensor.x * w.x * w.x + 2.0 * tensor.z * w.x * w.y + tensor.y * w.y * w.y;
}

// w_n (1 + 2 Lambda(w)) of Smith's masking, w in the frame of the normal. erfc: Abramowitz and Stegun 1964, 7.1.26.
float masking(Surface s, vec3 w) {
    float square = form(s.tensor, w);
    if (s.gamma == 0.0) return sqrt(w.z * w.z + square);
    float alpha = sqrt(max(square, 1e-2 * w.z * w.z)), a = w.z / alpha, e = exp(-a * a), t = 1.0 / (1.0 + 0.3275911 * a);
    float erfc = e * t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    return w.z * (1.0 - erfc) + alpha * e * inversesqrt(PI);
}

// f(theta, l, v), the cosine included: zero where n.l <= 0. Where the normal turns away from the viewer, masking holds n.v
// to 1e-4, and D is zero where n.h <= 0.
vec3 shade(Surface s, vec3 light, vec3 view) {
    vec3 l = inFrame(light, s.normal), v = inFrame(view, s.normal);
    if (l.z <= 1e-9) return vec3(0);
    vec3 halfway = normalize(light + view);
    vec3 h = inFrame(halfway, s.normal), S = s.tensor;
    float det = S.x * S.y - S.z * S.z;
    float q = (S.y * h.x * h.x - 2.0 * S.z * h.x * h.y + S.x * h.y * h.y) / det;
    float z2 = h.z * h.z;
    float D = s.gamma == 0.0 ? 1.0 / pow2(q + z2)
                             : s.norm * exp(-pow(max(q / max(z2, 1e-12), 1e-20), s.gamma)) / pow2(max(z2, 1e-12));
    D = h.z > 0.0 ? D / (PI * sqrt(det)) : 0.0;
    bool isotropic = S.x == S.y && S.z == 0.0;  // then masking knows the cosine alone
    if (v.z < 1e-4) v = isotropic ? vec3(1.0, 0.0, 1e-4) : vec3(v.xy, 1e-4);
    float V = 0.5 / (l.z * masking(s, v) + v.z * masking(s, l));
    float schlick = pow(max(1.0 - dot(light, halfway), 0.0), 5.0);
    vec3 F = s.f0 + (1.0 - s.f0) * schlick;
    float diffuse = s.dielectric > 0.5 ? 0.96 * (1.0 - schlick) : 1.0;
    return (s.albedo * diffuse / PI + D * V * F) * l.z;
}

vec3 appearance(vec2 uv, float lod, mat3 frame, vec3 view) {
    Surface s = surfaceAt(uv, lod);
    if (uShow == 1) return s.albedo;
    if (uShow == 2) return s.f0;
    if (uShow == 3) return 0.5 * s.normal + 0.5;
    if (uShow == 4) return vec3(pow(s.tensor.x * s.tensor.y - s.tensor.z * s.tensor.z, 0.125));
    if (uShow == 5) return vec3(lod / max(uLastLevel, 1.0));
    s.tensor.xy += uWiden;
    vec3 total = vec3(0);
    for (int k = 0; k < uLights; ++k) total += uRadiance[k] * shade(s, uDirection[k] * frame, view);
    return total;
}

// PCG3D's mixing (Jarzynski and Olano 2020): an independent shift of the sample sequence for every pixel.
vec2 shiftOfPixel() {
    uvec3 v = uvec3(gl_FragCoord.xy, 17) * 1664525u + 1013904223u;
    v.x += v.y * v.z; v.y += v.z * v.x; v.z += v.x * v.y;
    v ^= v >> 16u;
    v.x += v.y * v.z; v.y += v.z * v.x;
    return vec2(v.xy >> 8u) / 16777216.0;
}

void main() {
    vec3 n = normalize(vNormal);
    vec3 t = normalize(vTangent - dot(vTangent, n) * n);
    mat3 frame = mat3(t, cross(n, t), n);  // every mesh here has a right-handed frame
    vec3 view = normalize(uEye - vPosition) * frame;
    // uv / w and 1 / w are linear on the screen, so that their differences are exact, and differences of uv are not.
    float w = gl_FragCoord.w;
    vec2 dx = (dFdx(vUv * w) - vUv * dFdx(w)) / w, dy = (dFdy(vUv * w) - vUv * dFdy(w)) / w;
    // The level of detail: the longer axis of the pixel's footprint, in texels of level 0.
    vec2 size = vec2(textureSize(uMap0, 0));
    float a = dot(dx * size, dx * size), b = dot(dx * size, dy * size), c = dot(dy * size, dy * size);
    float lod = 0.5 * log2(0.5 * (a + c) + sqrt(0.25 * (a - c) * (a - c) + b * b));
    if (uSamples == 0) {
        outColor = vec4(appearance(vUv, clamp(lod, 0.0, uLastLevel), frame, view), 1);
        return;
    }
    vec2 shift = shiftOfPixel() + uStart;
    vec3 sum = vec3(0);
    float weights = 0.0;
    int table = textureSize(uFilter, 0).x;
    for (int i = 0; i < uSamples; ++i) {
        // The additive recurrence of the plastic number, low in discrepancy in two dimensions (Roberts 2018).
        vec2 u = fract(shift + float(i) * vec2(0.7548776662466927, 0.5698402909980532));
        ivec2 bin = min(ivec2(u * float(table)), table - 1);
        vec2 x = texelFetch(uFilter, ivec2(bin.x, 0), 0).xy, y = texelFetch(uFilter, ivec2(bin.y, 0), 0).xy;
        float weight = x.y * y.y;
        sum += weight * appearance(vUv + dx * x.x + dy * y.x, 0.0, frame, view);
        weights += weight;
    }
    // Alpha keeps the mean weight, by which the screen divides: filters with negative lobes have weights of both signs.
    vec4 before = uBlend < 1.0 ? texelFetch(uPrevious, ivec2(gl_FragCoord.xy), 0) : vec4(0);
    outColor = mix(before, vec4(sum, weights) / float(uSamples), uBlend);
}`;

const SCREEN_VERTEX_SHADER = `#version 300 es
void main() {
    gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1);
}`;

// Linear radiance of the sides to the screen: x / (1 + x) and the sRGB curve, as the tonemapped error measures.
const SCREEN_FRAGMENT_SHADER = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D uSide0, uSide1, uSide2;
uniform int uLast;  // the side to the right of the last divider
uniform bool uDiffer, uTonemap;  // sides show how they differ from the last one, or themselves
uniform float uExposure, uGain;
uniform vec2 uDividers;
uniform vec3 uBackground;
out vec4 outColor;

vec3 encode(vec3 x) {
    return mix(12.92 * x, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}

vec3 displayed(vec3 radiance) {
    vec3 x = max(radiance, 0.0);
    x = uTonemap ? min(x * uExposure, 1e6) : x;
    return encode(uTonemap ? x / (1.0 + x) : min(x, 1.0));
}

vec3 heat(float x) {  // dark to light through violet and orange: readable without colour vision, too
    const vec3 steps[5] = vec3[5](vec3(0.02, 0.02, 0.05), vec3(0.30, 0.07, 0.43), vec3(0.73, 0.22, 0.33),
                                  vec3(0.97, 0.56, 0.10), vec3(0.99, 0.97, 0.75));
    float place = clamp(x, 0.0, 1.0) * 4.0;
    int i = min(int(place), 3);
    return mix(steps[i], steps[i + 1], place - float(i));
}

vec4 weighed(vec4 side) {
    return vec4(side.rgb / (side.a != 0.0 ? side.a : 1.0), side.a);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 sides[3] = vec4[3](texelFetch(uSide0, pixel, 0), texelFetch(uSide1, pixel, 0), texelFetch(uSide2, pixel, 0));
    int here = min(int(gl_FragCoord.x >= uDividers.x) + int(gl_FragCoord.x >= uDividers.y), uLast);
    vec4 shown = weighed(sides[here]);
    vec3 color = displayed(shown.rgb);
    if (uDiffer && here != uLast) {
        vec3 difference = abs(color - displayed(weighed(sides[uLast]).rgb));
        color = heat(uGain * dot(difference, vec3(1.0 / 3.0)));
    }
    outColor = vec4(shown.a != 0.0 ? color : uBackground, 1);
}`;
