// The metallic-roughness model of glTF 2.0 (appendix B of its specification), as mipbake shades it. Isotropic: maps of
// anisotropy are left alone.

const float PI = 3.14159265358979;

vec3 shade(Surface s) {
    vec3 base = look_up(base_color_map).rgb, stored = look_up(normal_map).xyz * 2.0 - 1.0;
    float metallic = look_up(metallic_map).r;
    float roughness = max(look_up(roughness_map).r, 0.045);  // engines have the same floor
    float len = length(stored);
    vec3 n = len > 1e-6 ? s.frame * (stored / len) : s.frame[2], v = s.view;
    float a2 = pow(roughness, 4.0), nv = max(dot(n, v), 1e-4);  // held where the normal turns away from the viewer
    vec3 f0 = mix(vec3(0.04), base, metallic), total = vec3(0.0);
    for (int i = 0; i < light_count; i++) {
        vec3 l = light_directions[i];
        float nl = dot(n, l);
        if (nl <= 0.0) continue;
        vec3 h = normalize(l + v);
        // 1 - (n.h)^2 from the cross product, which keeps its digits near the peak of a narrow lobe.
        float nh = dot(n, h), weight = pow(max(1.0 - dot(l, h), 0.0), 5.0);
        vec3 across = cross(n, h);
        float q = nh * nh * a2 + dot(across, across);
        float d = nh > 0.0 ? a2 / (PI * q * q) : 0.0;
        float visible = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
        vec3 diffuse = base * (1.0 - metallic) / PI * 0.96 * (1.0 - weight);
        total += (diffuse + (f0 + (1.0 - f0) * weight) * d * visible) * nl * light_radiances[i];
    }
    return total;
}
