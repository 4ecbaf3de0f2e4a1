// Imports stacks that `mipbake bake SET --preset unity` wrote into Assets: DDS files beside a stack.json.
using System;
using System.IO;
using UnityEditor;
using UnityEngine;
using UnityEngine.Rendering;

namespace Mipbake
{
    public class MipbakePostprocessor : AssetPostprocessor
    {
        // Raise it when what is set below changes, so that Unity imports the textures again.
        public override uint GetVersion() { return 1; }

        // Unity keeps the levels of DDS files, but takes all as sRGB and filters within one level.
        void OnPreprocessAsset()
        {
            var importer = assetImporter as IHVImageFormatImporter;
            if (importer == null) return;
            string file = Path.GetFileName(assetPath);
            foreach (string manifest in Directory.GetFiles(Path.GetDirectoryName(assetPath), "stack*.json"))
            {
                Stack stack = Stack.Read(manifest);
                MapFiles files = stack.FilesForUnity();
                if (files == null || !files.Has(file)) continue;
                context.DependsOnSourceAsset(manifest.Replace('\\', '/'));
                importer.filterMode = FilterMode.Trilinear;
                importer.wrapModeU = WrapMode(stack.wrap.u);
                importer.wrapModeV = WrapMode(stack.wrap.v);
                // The class has no members for these two. The inspector sets the first one in the same way.
                var settings = new SerializedObject(importer);
                SerializedProperty srgb = settings.FindProperty("m_sRGBTexture");
                SerializedProperty aniso = settings.FindProperty("m_TextureSettings.m_Aniso");
                if (srgb != null) srgb.boolValue = file == files.base_color || file == files.emissive;
                else Debug.LogWarning($"mipbake: set sRGB of {assetPath} in the inspector, on for colours alone.");
                if (aniso != null) aniso.intValue = Math.Max(1, stack.provenance.sampler.lookups);
                settings.ApplyModifiedPropertiesWithoutUndo();
            }
        }

        static TextureWrapMode WrapMode(string wrap)
        {
            return wrap == "clamp" ? TextureWrapMode.Clamp : TextureWrapMode.Repeat;
        }

        static void OnPostprocessAllAssets(string[] imported, string[] deleted, string[] moved, string[] movedFrom)
        {
            foreach (string path in imported)
                if (Path.GetFileName(path).StartsWith("stack") && path.EndsWith(".json"))
                    MakeMaterial(path);
        }

        // The material lies beside the folder of the stack, because mipbake replaces that folder.
        static void MakeMaterial(string manifest)
        {
            Stack stack = Stack.Read(manifest);
            if (stack.schema != "mipbake-stack") return;  // somebody else's file
            MapFiles files = stack.FilesForUnity();
            if (files == null)
            {
                Debug.LogError($"mipbake: {manifest} is not of files for Unity: " +
                    "bake the set again with mipbake bake SET --preset unity.");
                return;
            }
            string folder = Path.GetDirectoryName(manifest).Replace('\\', '/');
            string beside = folder == "Assets" ? "Assets/material" : folder;
            string place = beside + Path.GetFileNameWithoutExtension(manifest).Substring("stack".Length) + ".mat";
            var material = AssetDatabase.LoadAssetAtPath<Material>(place);
            bool isNew = material == null;
            RenderPipelineAsset pipeline = GraphicsSettings.currentRenderPipeline;
            if (isNew) material = new Material(pipeline != null ? pipeline.defaultShader : Shader.Find("Standard"));

            // Properties of the Lit shaders of the High Definition and Universal pipelines, and of Standard.
            string gloss = pipeline != null ? "_METALLICSPECGLOSSMAP" : "_METALLICGLOSSMAP";
            bool complete = SetTexture(material, folder, files.base_color, "", "_BaseColorMap", "_BaseMap", "_MainTex")
                && SetTexture(material, folder, files.normal, "_NORMALMAP", "_NormalMap", "_BumpMap")
                && SetTexture(material, folder, files.roughness, "_MASKMAP", "_MaskMap")
                && SetTexture(material, folder, files.roughness, gloss, "_MetallicGlossMap")
                && SetTexture(material, folder, files.occlusion, "_OCCLUSIONMAP", "_OcclusionMap")
                && SetTexture(material, folder, files.emissive, "_EMISSIVE_COLOR_MAP", "_EmissiveColorMap")
                && SetTexture(material, folder, files.emissive, "_EMISSION", "_EmissionMap");
            if (!complete) return;
            if (isNew)
            {
                SetDefaults(material, files, stack.provenance.alpha_cutoff);
                AssetDatabase.CreateAsset(material, place);
            }
            EditorUtility.SetDirty(material);
            AssetDatabase.SaveAssetIfDirty(material);
            Debug.Log($"mipbake: {(isNew ? "made" : "updated")} {place}");
        }

        static bool SetTexture(Material material, string folder, string file, string keyword, params string[] names)
        {
            if (string.IsNullOrEmpty(file)) return true;
            var texture = AssetDatabase.LoadAssetAtPath<Texture2D>(folder + "/" + file);
            if (texture == null)
            {
                Debug.LogError($"mipbake: {folder}/{file} was not imported: " +
                    "copy the whole folder that mipbake wrote, right-click its stack.json and choose Reimport.");
                return false;
            }
            foreach (string name in names)
            {
                if (!material.HasProperty(name)) continue;
                material.SetTexture(name, texture);
                if (keyword != "") material.EnableKeyword(keyword);
            }
            return true;
        }

        // What a user may change afterwards: later imports leave it alone.
        static void SetDefaults(Material material, MapFiles files, float cutoff)
        {
            SetFloats(material, 1, "_Smoothness", "_GlossMapScale", "_SmoothnessRemapMax", "_MetallicRemapMax",
                "_AORemapMax", "_OcclusionStrength");
            SetFloats(material, 0, "_SmoothnessTextureChannel", "_SmoothnessRemapMin", "_MetallicRemapMin",
                "_AORemapMin", "_EnableGeometricSpecularAA");
            if (material.HasProperty("_NormalMap")) material.EnableKeyword("_NORMALMAP_TANGENT_SPACE");
            if (!string.IsNullOrEmpty(files.emissive))
            {
                foreach (string name in new[] { "_EmissiveColor", "_EmissionColor" })
                    if (material.HasProperty(name)) material.SetColor(name, Color.white);
                material.globalIlluminationFlags = MaterialGlobalIlluminationFlags.BakedEmissive;
            }
            if (cutoff <= 0) return;
            SetFloats(material, 1, "_AlphaClip", "_AlphaCutoffEnable", "_Mode");
            SetFloats(material, cutoff, "_Cutoff", "_AlphaCutoff");
            material.EnableKeyword("_ALPHATEST_ON");
            material.renderQueue = (int)RenderQueue.AlphaTest;
        }

        static void SetFloats(Material material, float value, params string[] names)
        {
            foreach (string name in names)
                if (material.HasProperty(name)) material.SetFloat(name, value);
        }
    }

    // What JsonUtility takes from a stack.json: fields have the names in the file.
    [Serializable] class Wrap { public string u = "", v = ""; }
    [Serializable] class Sampler { public int lookups = 0; }
    [Serializable] class Provenance { public float alpha_cutoff = 0; public Sampler sampler = new Sampler(); }

    [Serializable] class MapFiles
    {
        public string base_color = "", normal = "", roughness = "", occlusion = "", emissive = "", height = "";

        public bool Has(string file)
        {
            return Array.IndexOf(new[] { base_color, normal, roughness, emissive, height }, file) >= 0;
        }
    }

    [Serializable] class Output
    {
        public string format = "", packing = "", normal_convention = "";
        public MapFiles map_files = new MapFiles();
    }

    [Serializable] class Stack
    {
        public string schema = "";
        public Wrap wrap = new Wrap();
        public Provenance provenance = new Provenance();
        public Output[] outputs = new Output[0];

        // An empty stack where the file is none.
        public static Stack Read(string manifest)
        {
            try { return JsonUtility.FromJson<Stack>(File.ReadAllText(manifest)) ?? new Stack(); }
            catch (ArgumentException) { return new Stack(); }
        }

        // The files that Unity uses as they are; null where there are none.
        public MapFiles FilesForUnity()
        {
            foreach (Output output in outputs)
                if (schema == "mipbake-stack" && output.format == "dds" && output.packing == "mask-map" &&
                    output.normal_convention == "OpenGL" && !string.IsNullOrEmpty(output.map_files.roughness))
                    return output.map_files;
            return null;
        }
    }
}
