// What integrations/unity uses of Unity, by the signatures of the scripting reference of Unity 6, and an editor that
// imports the files of a folder. `mono editor.exe SHADER [twice] [hide]` prints a line for each texture, message and
// material. twice: the user changes the materials, and everything is imported again. hide: settings have other names.
using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Text;
using UnityEditor.AssetImporters;

namespace UnityEngine
{
    public enum FilterMode { Point, Bilinear, Trilinear }
    public enum TextureWrapMode { Repeat, Clamp, Mirror, MirrorOnce }
    [Flags] public enum MaterialGlobalIlluminationFlags { RealtimeEmissive = 1, BakedEmissive = 2, EmissiveIsBlack = 4 }

    public class Object { public string name = ""; }
    public class Texture : Object { }
    public class Texture2D : Texture { }
    public struct Color { public static Color white { get { return new Color(); } } }

    public class Shader : Object
    {
        public string[] properties;

        public static Shader Find(string name)
        {
            return new Shader { name = name, properties = Stage.Editor.Properties["Standard"] };
        }
    }

    public class Material : Object
    {
        readonly Shader shader;
        public readonly SortedDictionary<string, string> values = new SortedDictionary<string, string>();
        public readonly SortedSet<string> keywords = new SortedSet<string>();

        public MaterialGlobalIlluminationFlags globalIlluminationFlags =
            MaterialGlobalIlluminationFlags.EmissiveIsBlack;

        public Material(Shader shader) { this.shader = shader; }
        public int renderQueue { get; set; }
        public bool HasProperty(string name) { return shader.properties.Contains(name); }
        public void SetTexture(string name, Texture value) { Keep(name, value.name); }
        public void SetFloat(string name, float value) { Keep(name, value.ToString(CultureInfo.InvariantCulture)); }
        public void SetColor(string name, Color value) { Keep(name, "white"); }
        public void EnableKeyword(string keyword) { keywords.Add(keyword); }

        void Keep(string name, string value)
        {
            if (!HasProperty(name)) throw new InvalidOperationException(shader.name + " has no " + name);
            values[name] = value;
        }

        public override string ToString()
        {
            return shader.name + " " + string.Join(" ", values.Select(each => each.Key + "=" + each.Value)) + " | " +
                string.Join(" ", keywords) + " | " + globalIlluminationFlags + " " + renderQueue;
        }
    }

    public static class Debug
    {
        public static void Log(object message) { Console.WriteLine("log " + message); }
        public static void LogWarning(object message) { Console.WriteLine("warning " + message); }
        public static void LogError(object message) { Console.WriteLine("error " + message); }
    }

    // Fields by name, at any depth; what has no field is left out, and null leaves a field as it is.
    public static class JsonUtility
    {
        public static T FromJson<T>(string json)
        {
            var parsed = new Stage.Json(json).Value() as Dictionary<string, object>;
            if (parsed == null) throw new ArgumentException("JSON must represent an object type.");
            return (T)Made(typeof(T), parsed);
        }

        static object Made(Type type, object value)
        {
            if (type == typeof(string)) return (string)value;
            if (type.IsPrimitive) return Convert.ChangeType(value, type, CultureInfo.InvariantCulture);
            if (type.IsArray)
            {
                var list = (List<object>)value;
                var array = Array.CreateInstance(type.GetElementType(), list.Count);
                for (int i = 0; i < list.Count; i++) array.SetValue(Made(type.GetElementType(), list[i]), i);
                return array;
            }
            if (!type.IsSerializable) throw new ArgumentException(type + " is not marked as Serializable");
            object made = Activator.CreateInstance(type);
            foreach (var pair in (Dictionary<string, object>)value)
            {
                FieldInfo field = type.GetField(pair.Key, BindingFlags.Public | BindingFlags.Instance);
                if (field != null && pair.Value != null) field.SetValue(made, Made(field.FieldType, pair.Value));
            }
            return made;
        }
    }
}

namespace UnityEngine.Rendering
{
    public enum RenderQueue { Geometry = 2000, AlphaTest = 2450, Transparent = 3000 }

    public class RenderPipelineAsset : Object
    {
        public Shader shader;
        public virtual Shader defaultShader { get { return shader; } }
    }

    public static class GraphicsSettings { public static RenderPipelineAsset currentRenderPipeline { get; set; } }
}

namespace UnityEditor.AssetImporters
{
    public class AssetImportContext
    {
        public readonly List<string> sources = new List<string>();
        public void DependsOnSourceAsset(string path) { sources.Add(path); }
    }
}

namespace UnityEditor
{
    using UnityEngine;

    public class AssetImporter : UnityEngine.Object { }

    public sealed class IHVImageFormatImporter : AssetImporter
    {
        public FilterMode filterMode { get; set; } = FilterMode.Bilinear;
        public TextureWrapMode wrapModeU { get; set; }
        public TextureWrapMode wrapModeV { get; set; }
        public readonly SerializedProperty srgb = new SerializedProperty { boolValue = true };
        public readonly SerializedProperty aniso = new SerializedProperty { intValue = 1 };
    }

    public class AssetPostprocessor
    {
        public string assetPath { get; set; }
        public AssetImporter assetImporter { get; set; }
        public AssetImportContext context { get; set; }
        public virtual uint GetVersion() { return 0; }
    }

    public class SerializedProperty { public bool boolValue { get; set; } public int intValue { get; set; } }

    public class SerializedObject
    {
        readonly IHVImageFormatImporter importer;
        public SerializedObject(UnityEngine.Object obj) { importer = (IHVImageFormatImporter)obj; }

        public SerializedProperty FindProperty(string propertyPath)
        {
            if (Stage.Editor.HidesSettings) return null;
            return propertyPath == "m_sRGBTexture" ? importer.srgb
                : propertyPath == "m_TextureSettings.m_Aniso" ? importer.aniso : null;
        }

        public bool ApplyModifiedPropertiesWithoutUndo() { return true; }
    }

    public static class AssetDatabase
    {
        public static T LoadAssetAtPath<T>(string assetPath) where T : UnityEngine.Object
        {
            UnityEngine.Object found;
            return Stage.Editor.Assets.TryGetValue(assetPath, out found) ? found as T : null;
        }

        public static void CreateAsset(UnityEngine.Object asset, string path) { Stage.Editor.Assets.Add(path, asset); }
        public static void SaveAssetIfDirty(UnityEngine.Object obj) { }
    }

    public static class EditorUtility { public static void SetDirty(UnityEngine.Object target) { } }
}

namespace Stage
{
    using UnityEditor;
    using UnityEngine;
    using UnityEngine.Rendering;

    public static class Editor
    {
        public static readonly Dictionary<string, UnityEngine.Object> Assets =
            new Dictionary<string, UnityEngine.Object>();
        public static bool HidesSettings;

        // Properties of the shaders that materials get, as their sources name them.
        public static readonly Dictionary<string, string[]> Properties = new Dictionary<string, string[]>
        {
            { "Standard", ("_Color _MainTex _Cutoff _Glossiness _GlossMapScale _SmoothnessTextureChannel _Metallic " +
                "_Mode _MetallicGlossMap _BumpMap _OcclusionStrength _OcclusionMap _EmissionColor " +
                "_EmissionMap").Split() },
            { "Universal Render Pipeline/Lit", ("_BaseMap _BaseColor _MainTex _Cutoff _Smoothness _Metallic " +
                "_AlphaClip _SmoothnessTextureChannel _MetallicGlossMap _BumpMap _OcclusionStrength _OcclusionMap " +
                "_Surface _EmissionColor _EmissionMap").Split() },
            { "HDRP/Lit", ("_BaseColor _BaseColorMap _MainTex _Metallic _Smoothness _MaskMap _SmoothnessRemapMin " +
                "_SmoothnessRemapMax _MetallicRemapMin _MetallicRemapMax _AORemapMin _AORemapMax _NormalMap " +
                "_EmissiveColor _EmissiveColorMap _AlphaCutoffEnable _AlphaCutoff " +
                "_EnableGeometricSpecularAA").Split() },
        };

        public static void Main(string[] arguments)
        {
            string pipeline = arguments[0];
            HidesSettings = arguments.Contains("hide");
            if (pipeline != "Standard")
                GraphicsSettings.currentRenderPipeline = new RenderPipelineAsset {
                    shader = new Shader { name = pipeline, properties = Properties[pipeline] } };
            Import();
            if (arguments.Contains("twice"))
            {
                foreach (Material made in Assets.Values.OfType<Material>()) made.SetFloat("_OcclusionStrength", 0.5f);
                Import();
            }
            foreach (var asset in Assets.OrderBy(each => each.Key, StringComparer.Ordinal))
                if (asset.Value is Material) Console.WriteLine("material " + asset.Key + " " + asset.Value);
        }

        static void Import()
        {
            string[] files = Directory.GetFiles("Assets", "*.*", SearchOption.AllDirectories)
                .Select(each => each.Replace('\\', '/')).OrderBy(each => each, StringComparer.Ordinal).ToArray();
            foreach (string path in files)
            {
                var importer = path.EndsWith(".dds") ? new IHVImageFormatImporter() : new AssetImporter();
                var processor = new Mipbake.MipbakePostprocessor {
                    assetPath = path, assetImporter = importer, context = new AssetImportContext() };
                Call(processor, "OnPreprocessAsset");
                var texture = importer as IHVImageFormatImporter;
                if (texture == null) continue;
                Assets[path] = new Texture2D { name = Path.GetFileName(path) };
                Console.WriteLine("texture " + string.Join(" ", new object[] {
                    path, texture.filterMode, texture.wrapModeU, texture.wrapModeV,
                    texture.srgb.boolValue, texture.aniso.intValue,
                    string.Join(" ", processor.context.sources) }));
            }
            Call(null, "OnPostprocessAllAssets", files, new string[0], new string[0], new string[0]);
        }

        // Unity finds these methods by their names.
        static void Call(object processor, string name, params object[] arguments)
        {
            const BindingFlags any = BindingFlags.NonPublic | BindingFlags.Static | BindingFlags.Instance;
            typeof(Mipbake.MipbakePostprocessor).GetMethod(name, any).Invoke(processor, arguments);
        }
    }

    // A reader of JSON: objects, arrays, strings without escapes but \" and \\, numbers, true, false, null.
    public class Json
    {
        readonly string text;
        int at;

        public Json(string text) { this.text = text; }

        public object Value()
        {
            char first = Next();
            if (first == '{' || first == '[') return first == '{' ? (object)Members() : Items();
            if (first == '"') return Text();
            int start = at - 1;
            while (at < text.Length && ",]} \r\n".IndexOf(text[at]) < 0) at++;
            string word = text.Substring(start, at - start);
            double number;
            if (word == "null") return null;
            if (word == "true" || word == "false") return word == "true";
            if (double.TryParse(word, NumberStyles.Float, CultureInfo.InvariantCulture, out number)) return number;
            throw new ArgumentException("JSON parse error: " + word);
        }

        char Next()
        {
            while (at < text.Length && char.IsWhiteSpace(text[at])) at++;
            if (at == text.Length) throw new ArgumentException("JSON parse error: the document is empty");
            return text[at++];
        }

        Dictionary<string, object> Members()
        {
            var found = new Dictionary<string, object>();
            for (char next = Next(); next != '}'; next = Next())
            {
                if (next == ',') next = Next();
                string name = Text();
                if (next != '"' || Next() != ':') throw new ArgumentException("JSON parse error: a name is missing");
                found[name] = Value();
            }
            return found;
        }

        List<object> Items()
        {
            var found = new List<object>();
            for (char next = Next(); next != ']'; next = Next())
            {
                if (next != ',') at--;
                found.Add(Value());
            }
            return found;
        }

        string Text()
        {
            var found = new StringBuilder();
            for (; text[at] != '"'; at++) found.Append(text[at] == '\\' ? text[++at] : text[at]);
            at++;
            return found.ToString();
        }
    }
}
