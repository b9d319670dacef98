# What spacearm_path.dsv says, for a shell that sources this package alone.
case ":$PATH:" in
  *":$COLCON_CURRENT_PREFIX/share/spacearm_ident/bin:"*) ;;
  *) export PATH="$COLCON_CURRENT_PREFIX/share/spacearm_ident/bin:$PATH" ;;
esac
