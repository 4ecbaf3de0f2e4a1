// A stylised surface: diffuse and specular light fall in a few hard steps, so the image has no derivatives that help.
// All numbers of steps are guesses.

const float PI = 3.14159265358979;
const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722);  // ITU-R BT.709
const float DIFFUSE_STEP = 0.25;  // of what a white surface reflects

// Light of the same colour, whose luminance is one of the steps.
vec3 stepped(vec3 light, float luminance) { return light * (luminance / max(dot(light, LUMINANCE), 1e-6)); }

vec3 shade(Surface s) {
    vec3 base = look_up(base_color_map).rgb, stored = look_up(normal_map).xyz * 2.0 - 1.0;
    float metallic = look_up(metallic_map).r, roughness = max(look_up(roughness_map).r, 0.045);
    float len = length(stored);
    vec3 n = len > 1e-6 ? s.frame * (stored / len) : s.frame[2];
    float shininess = 2.0 / pow(roughness, 4.0);  // of Blinn and Phong, whose lobe is about as wide as GGX's
    vec3 diffuse = vec3(0.0), highlight = vec3(0.0);
    for (int i = 0; i < light_count; i++) {
        float nl = max(dot(n, light_directions[i]), 0.0);
        float nh = max(dot(n, normalize(light_directions[i] + s.view)), 0.0);
        diffuse += nl / PI * light_radiances[i];
        highlight += nl * pow(nh, shininess) * light_radiances[i];
    }
    // Three steps of shadow and light, and on from there where it is brighter.
    diffuse = stepped(diffuse, DIFFUSE_STEP * floor(dot(diffuse, LUMINANCE) / DIFFUSE_STEP + 0.5));
    float bright = dot(highlight, LUMINANCE);
    highlight = stepped(highlight, 0.3 * step(0.15, bright) + 0.7 * step(0.6, bright));
    return base * (1.0 - metallic) * diffuse + mix(vec3(0.3), base, metallic) * (highlight + metallic * 0.5 * diffuse);
}
