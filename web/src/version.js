/** The version of the package, which package.json has, too. */
export default '0.1.0';
