// Metallic-roughness under a clear coat, as KHR_materials_clearcoat describes it: the coat reflects by its own lobe, and
// its Fresnel term, seen from the camera, takes as much from what lies below. The coat is everywhere, smooth, and has the
// normal of the mesh.

const float PI = 3.14159265358979;
const float COAT_ROUGHNESS = 0.1, COAT_F0 = 0.04;

float fresnel(float f0, float cosine) { return f0 + (1.0 - f0) * pow(clamp(1.0 - cosine, 0.0, 1.0), 5.0); }

// D V of GGX with height-correlated masking; a2 is roughness^4. n.v is held where the normal turns away from the viewer.
float lobe(vec3 n, vec3 h, float nl, float seen, float a2) {
    float nh = dot(n, h), nv = max(seen, 1e-4);
    if (nh <= 0.0) return 0.0;
    vec3 across = cross(n, h);
    float q = nh * nh * a2 + dot(across, across);
    float visible = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
    return a2 / (PI * q * q) * visible;
}

vec3 shade(Surface s) {
    vec3 base = look_up(base_color_map).rgb, stored = look_up(normal_map).xyz * 2.0 - 1.0;
    float metallic = look_up(metallic_map).r;
    float roughness = max(look_up(roughness_map).r, 0.045);  // engines have the same floor
    float len = length(stored);
    vec3 n = len > 1e-6 ? s.frame * (stored / len) : s.frame[2], coat = s.frame[2], v = s.view;
    float a2 = pow(roughness, 4.0), coat_a2 = pow(COAT_ROUGHNESS, 4.0), nv = dot(n, v), coat_nv = dot(coat, v);
    vec3 f0 = mix(vec3(0.04), base, metallic), total = vec3(0.0);
    if (coat_nv <= 0.0) return total;
    float passed = 1.0 - fresnel(COAT_F0, coat_nv);
    for (int i = 0; i < light_count; i++) {
        vec3 l = light_directions[i], h = normalize(l + v), seen = vec3(0.0);
        float nl = dot(n, l), coat_nl = dot(coat, l), lh = dot(l, h);
        if (nl > 0.0) {
            float weight = pow(max(1.0 - lh, 0.0), 5.0);
            vec3 diffuse = base * (1.0 - metallic) / PI * 0.96 * (1.0 - weight);
            seen += passed * (diffuse + (f0 + (1.0 - f0) * weight) * lobe(n, h, nl, nv, a2)) * nl;
        }
        if (coat_nl > 0.0) seen += fresnel(COAT_F0, lh) * lobe(coat, h, coat_nl, coat_nv, coat_a2) * coat_nl;
        total += seen * light_radiances[i];
    }
    return total;
}
